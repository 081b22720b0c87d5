"""A log that a store has already is not added again because something else is noted of it today."""

from __future__ import annotations

import pytest
import yaml
from two_joint_log import a_log, a_mapping
from walker_recording import a_recording

from hts.cli import import_
from hts.recordings import RecordingStore, Series
from hts.recordings.same_data import Known

LATER = {"repeated_while_moving": "joint_torque from 1.00 to 2.00 s"}


@pytest.fixture
def store(tmp_path):
    return RecordingStore(tmp_path / "data.zarr", create=True)


def test_the_same_data_is_found_whatever_its_notes(store):
    with_source = a_recording(notes={"source": "walk.csv"})
    there = store.write(with_source)
    known = Known(store)
    assert known.find(with_source) == (there, True)
    assert known.find(a_recording(notes={"source": "walk.csv", **LATER})) == (there, False)


def test_of_two_with_the_same_data_that_with_the_same_notes_is_meant(store):
    first = store.write(a_recording(notes={"source": "walk.csv"}))
    second = store.write(a_recording(notes={"source": "walk.csv", **LATER}))
    known = Known(store)
    assert first != second
    assert known.find(a_recording(notes={"source": "walk.csv"})) == (first, True)
    assert known.find(a_recording(notes={"source": "walk.csv", **LATER})) == (second, True)


@pytest.mark.parametrize(
    "changes",
    [
        {"notes": {"source": "other.csv"}},
        {"mass_kg": 13.0},
        {"idle": {"draw": 1.0, "warmth": 25.0}},
        {"kp": (25.0, 20.0)},
        {"role": "reference"},
        {"samples": 49},
    ],
    ids=["source", "mass", "idle", "gains", "role", "values"],
)
def test_other_data_another_source_or_other_stated_facts_are_another_recording(store, changes):
    store.write(a_recording(notes={"source": "walk.csv"}))
    assert Known(store).find(a_recording(**{"notes": {"source": "walk.csv"}, **changes})) is None


def test_a_damaged_recording_is_not_taken_for_the_data(store):
    there = store.write(a_recording())
    (store.path / there / "zarr.json").write_text("{")
    assert Known(store).find(a_recording()) is None


@pytest.fixture
def import_log(monkeypatch, tmp_path):
    """`hts import` of one log into a store, with these notes of what the values look like."""
    from test_import_commands import OneRobot

    monkeypatch.setattr("hts.plugins.load", OneRobot)
    log, mapping = a_log(tmp_path), tmp_path / "m.yaml"

    def command(notes, **recorded):
        mapping.write_text(yaml.safe_dump(a_mapping(recording=recorded)))
        monkeypatch.setattr("hts.recordings.look_over.repeated_notes", lambda channels, rate_hz: notes)
        import_.command([log], "logger", mapping, tmp_path / "data.zarr")

    return command


def test_a_log_of_which_more_is_noted_today_is_not_imported_twice(import_log, tmp_path, capsys):
    import_log({})
    first = capsys.readouterr().out
    import_log(LATER)
    again = capsys.readouterr().out
    (there,) = RecordingStore(tmp_path / "data.zarr").ids()
    assert first.startswith(there) and "already" not in first
    assert again.startswith(
        f"{there}  log.csv: 0.20 s at 50 Hz, draw, joint_torque (was there already, with other notes"
    )
    assert "repeated_while_moving joint_torque from 1.00 to 2.00 s" in again and again.count("\n") == 1
    import_log({})
    assert "(was there already)" in capsys.readouterr().out


def test_a_log_that_is_imported_with_another_mass_is_another_recording(import_log, tmp_path):
    import_log({})
    import_log({}, mass_kg=12.0)
    assert len(RecordingStore(tmp_path / "data.zarr").ids()) == 2


def test_a_walk_that_is_there_under_another_name_or_with_other_facts_is_found(store):
    there = store.write(a_recording(notes={"source": "walk.csv"}))
    known = Known(store)
    found = (there, "walk.csv", "joint_torque")
    assert known.walk_of(a_recording(notes={"source": "copy.csv"})) == found
    assert known.walk_of(a_recording(notes={"source": "walk.csv"}, policy_hash="another")) == found
    assert known.walk_of(a_recording(notes={"source": "walk.csv"})) is None  # that is itself there
    assert known.walk_of(a_recording(notes={"source": "walk.csv"}, samples=49)) is None


def test_one_that_was_stored_since_is_found_too_and_what_stands_still_is_not(store):
    known = Known(store)
    assert known.walk_of(a_recording()) is None
    known.add("since", a_recording(notes={"source": "walk.csv"}))
    assert known.walk_of(a_recording(notes={"source": "copy.csv"})) == ("since", "walk.csv", "joint_torque")
    still = a_recording().channels
    still = {name: Series(one.channel, one.values * 0 + 1) for name, one in still.items()}
    known.add("still", a_recording(channels=still))
    assert known.walk_of(a_recording(channels=still, notes={"source": "copy.csv"})) is None


def test_an_import_says_that_the_store_has_the_walk_already(import_log, tmp_path, capsys):
    import_log({})
    (there,) = RecordingStore(tmp_path / "data.zarr").ids()
    assert capsys.readouterr().err == ""
    import_log({}, mass_kg=12.0)
    said = capsys.readouterr().err
    assert said.startswith(f"note: {tmp_path / 'log.csv'}: 'draw' holds the same samples as recording {there} of ")
    assert f"delete {tmp_path / 'data.zarr' / there} if it is the one that is wrong" in said
