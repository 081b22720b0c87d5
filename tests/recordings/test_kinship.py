"""Recordings of one store go together."""

from __future__ import annotations

import pytest

from hts.channels import Channel
from hts.errors import RecordingError
from hts.recordings import RecordingStore, Series
from hts.recordings.kinship import check_kinship
from hts.testing.made_up_recordings import made_up_recording


@pytest.fixture
def known():
    return made_up_recording({"effort": Channel("effort", "N*m", (2,))}, {"heat": Channel("heat", "W")})


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"robot": "somebody"}, "it is of robot 'somebody', but .* of 'nobody'"),
        ({"joint_names": ("knee",)}, "its joints are knee, but .* has joint"),
        ({"rate_hz": 51.0}, "it has 51 Hz, but .* has 50 Hz"),
    ],
)
def test_what_does_not_go_with_a_store_is_named(tmp_path, known, changes, expected):
    store = RecordingStore(tmp_path / "s.zarr", create=True)
    store.write(known)
    with pytest.raises(RecordingError, match=expected) as refused:
        check_kinship(store, [known, known.replace(**changes)])
    assert "\n" not in str(refused.value)
    check_kinship(store, [known, known.replace(block=7)])


def test_the_first_recordings_of_a_new_store_are_compared_with_each_other(known):
    with pytest.raises(RecordingError, match="it is of robot 'somebody'"):
        check_kinship(None, [known, known.replace(robot="somebody")])


@pytest.mark.parametrize(
    ("channel", "expected"),
    [(Channel("heat", "V"), "its 'heat' is in V, but .* has it in W"), (Channel("heat", "J/s"), None)],
)
def test_units_are_compared_by_what_they_mean(known, channel, expected):
    other = known.replace(channels={**known.channels, "heat": Series(channel, known.values("heat"))})
    if expected is None:
        check_kinship(None, [known, other])
    else:
        with pytest.raises(RecordingError, match=expected):
            check_kinship(None, [known, other])


def test_a_channel_that_only_some_have_is_no_difference(known):
    fewer = known.replace(channels={"heat": known.channels["heat"]})
    check_kinship(None, [known, fewer, known])


def test_a_damaged_recording_of_the_store_does_not_stand_in_the_way(tmp_path, known):
    store = RecordingStore(tmp_path / "s.zarr", create=True)
    (store.path / store.write(known) / "zarr.json").write_text("{")
    check_kinship(store, [known])
