"""Rows that are no part of a run, such as turns at a wall, are left out and the clock is closed up over them."""

from __future__ import annotations

import numpy as np
import pytest

from hts.errors import ConfigError, RecordingError
from hts.recordings.csv_reader import make

ROWS = 120
PHASE = np.zeros(ROWS)
PHASE[:5] = 2  # it begins in the midst of a turn
PHASE[30:60], PHASE[60:70] = 1, 2
PHASE[110:] = 1
COUNT = np.flatnonzero(PHASE == 0)


@pytest.fixture
def amps(mapping):
    """Only the gauge, in rows that count."""
    del mapping["channels"]["joint_torque"], mapping["joints"]
    mapping["only"] = {"column": "phase"}
    return mapping


def a_log(path, phase=PHASE, jitter=0.0, values=None):
    stamps = 20 * np.arange(len(phase)) + jitter * np.random.default_rng(0).uniform(-1, 1, len(phase))
    values = np.arange(len(phase)) + 2.0 if values is None else values
    shown = ["" if np.isnan(one) else f"{one:g}" for one in phase]
    lines = [f"{t:.4f},{value:g},{one}" for t, value, one in zip(stamps, values, shown, strict=True)]
    path.write_text("\n".join(["t,amps,phase", *lines]) + "\n")
    return path


def test_turns_are_left_out_and_what_is_before_and_after_them_follows_each_other(tmp_path, amps, two_joints):
    recording = make({}).read([a_log(tmp_path / "a.csv")], amps, two_joints)
    np.testing.assert_allclose(recording.values("draw"), COUNT + 2.0, rtol=1e-6)
    np.testing.assert_allclose(recording.time, np.arange(len(COUNT)) / 50, atol=1e-9)
    assert recording.notes["rows_left_out"] == "55 of 120 ('phase' is not 0)"
    assert recording.notes["closed_up_at"] == "0.49"  # halfway between two samples


def test_a_clock_that_jitters_loses_no_sample(tmp_path, amps, two_joints):
    recording = make({}).read([a_log(tmp_path / "a.csv", jitter=3.0)], amps, two_joints)
    assert len(COUNT) - 1 <= recording.num_samples <= len(COUNT)
    far = np.abs(recording.values("draw")[:, None] - (COUNT + 2.0)).min(axis=1)
    assert np.quantile(far, 0.9) < 0.3


def test_a_log_without_turns_reads_as_one_without_the_key(tmp_path, amps, two_joints):
    log = a_log(tmp_path / "a.csv", np.zeros(ROWS))
    with_key = make({}).read([log], amps, two_joints)
    del amps["only"]
    without = make({}).read([log], amps, two_joints)
    np.testing.assert_array_equal(with_key.values("draw"), without.values("draw"))
    assert with_key.notes == without.notes


def test_a_row_without_a_phase_is_of_the_phase_before_it(tmp_path, amps, two_joints):
    phase = np.where(np.arange(ROWS) % 3 == 0, PHASE, np.nan)
    recording = make({}).read([a_log(tmp_path / "a.csv", phase)], amps, two_joints)
    kept = np.flatnonzero(np.repeat(PHASE[::3], 3) == 0)
    np.testing.assert_allclose(recording.values("draw"), kept + 2.0, rtol=1e-6)


def test_the_other_file_of_a_log_loses_the_same_seconds(tmp_path, amps, two_joints):
    log, other = a_log(tmp_path / "a.csv"), tmp_path / "volts.csv"
    stamps = np.arange(4.0, 20 * ROWS, 10.0)  # twice as many rows, between those of the other
    other.write_text("\n".join(["t,volts", *(f"{t:g},{0.05 * t:g}" for t in stamps)]) + "\n")
    amps["files"] = {"body": "a.csv", "pack": "volts.csv"}
    amps["one_clock"] = True
    amps["channels"]["draw"]["file"] = "body"
    amps["channels"]["volts"] = {"columns": "volts", "unit": "V", "file": "pack", "real": False}
    with pytest.raises(ConfigError, match="only: `file` goes with `files`; give both or neither"):
        make({}).read([log, other], amps, two_joints)
    amps["only"]["file"] = "nobody"
    with pytest.raises(ConfigError, match="only: No file named 'nobody'"):
        make({}).read([log, other], amps, two_joints)
    amps["only"]["file"] = "body"
    recording = make({}).read([log, other], amps, two_joints)
    rows = recording.values("draw") - 2.0  # its row in the log, and so its time
    away = np.abs(recording.values("volts") - rows) > 0.6
    assert away.sum() <= 2  # beside the joint
    assert recording.num_samples == pytest.approx(len(COUNT), abs=1)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"only": {"column": "fase"}}, "No column named 'fase'. The file has: t, amps, phase"),
        ({"only": {"column": "phase", "number": 7}}, "in 0 rows 'phase' is 7, those that count .*it holds 0, 1, 2"),
        ({"runs": {"gap_seconds": 1}}, "`only` closes the log's clock up, so it does not go with `runs`"),
        ({"cut": [0, 1]}, "`only` closes the log's clock up, so it does not go with `cut`"),
    ],
)
def test_what_cannot_be_meant_is_one_line(tmp_path, amps, two_joints, changes, said):
    with pytest.raises((ConfigError, RecordingError), match=said) as found:
        make({}).read([a_log(tmp_path / "a.csv")], {**amps, **changes}, two_joints)
    assert "\n" not in str(found.value)


def test_a_log_of_a_fall_in_a_turn_that_holds_nothing_else_is_kept(tmp_path, amps, two_joints):
    log = a_log(tmp_path / "a.csv", np.ones(ROWS))
    with pytest.raises(RecordingError, match="in 0 rows 'phase' is 0"):
        make({}).read([log], amps, two_joints)
    amps["recording"] = {**amps.get("recording", {}), "fell": True}
    assert make({}).read([log], amps, two_joints).num_samples == ROWS
