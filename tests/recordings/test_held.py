"""A gauge that is slower than the joints: its last reading stands until the next, and not for ever."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import yaml
from two_joint_log import a_log, a_mapping, read

from hts.errors import ConfigError, RecordingError
from hts.recordings.logs import common_grid, held, resampled, samples_of
from hts.recordings.suggest import suggested_mapping

STEPS = np.arange(200)
HELD = {"columns": "amps", "unit": "A", "idle": 1.5, "resample": "hold"}
READINGS = 3 + (STEPS // 5 % 7)
"""A of a gauge that is read at 10 Hz, in a table of 50 Hz."""


def rows(shown=lambda step: step % 5 == 0, count=200):
    """The gauge's cell is blank where nothing was read."""
    return [f"{20 * i},{i % 7},{-(i % 5)},{READINGS[i] if shown(i) else ''}" for i in range(count)]


def held_mapping(**changes: Any) -> dict[str, Any]:
    mapping = a_mapping()
    mapping["channels"]["draw"] = {**HELD, **changes}
    return mapping


def test_a_slow_gauge_in_a_fast_table_is_held(tmp_path):
    recording = read(a_log(tmp_path, rows()), held_mapping())
    assert np.array_equal(recording.values("draw"), READINGS)
    np.testing.assert_allclose(recording.values("joint_torque")[:, 1], STEPS % 7, atol=1e-6)
    assert recording.notes["readings_held"] == "draw from 10 Hz, for up to 0.3 s"
    assert not {"incomplete_rows_filled", "samples_interpolated_in_gaps", "ends_before_last_stamp"} & {*recording.notes}


def test_held_by_us_is_what_a_logger_that_repeats_would_have_written(tmp_path):
    ours = read(a_log(tmp_path, rows()), held_mapping())
    theirs = read(a_log(tmp_path, rows(lambda step: True)), held_mapping(resample="interpolate"))
    for name in ("draw", "joint_torque"):
        assert np.array_equal(ours.values(name), theirs.values(name))


def test_a_slow_gauge_in_a_file_of_its_own_is_held(tmp_path):
    """Its stamps lie between those of the joints: samples from its first one on."""
    walk = a_log(tmp_path, [row.rpartition(",")[0] for row in rows()], "t,K_tau,H_tau", "walk.csv")
    gauge = a_log(tmp_path, [f"{993 + 100 * i},{READINGS[5 * i]}" for i in range(40)], "t,amps", "gauge.csv")
    mapping = held_mapping(file="gauge") | {"files": {"walk": "walk*", "gauge": "gauge*"}}
    mapping["channels"]["joint_torque"]["file"] = "walk"
    recording = read([walk, gauge], mapping)
    times = 0.993 + recording.time
    assert np.array_equal(recording.values("draw"), READINGS[5 * ((times - 0.993 + 1e-9) / 0.1).astype(int)])
    assert recording.notes["readings_held"] == "draw from 10 Hz, for up to 0.3 s"


def test_an_outage_is_refused_unless_the_mapping_allows_readings_that_old(tmp_path):
    log = a_log(tmp_path, rows(lambda step: step % 5 == 0 and not 50 < step < 70))
    with pytest.raises(RecordingError) as refused:
        read(log, held_mapping())
    assert str(refused.value) == (
        f"{log}: 'draw' (amps) has nothing for 0.4 s, from 1.000 s on; a reading of it is held for up to 0.3 s (it "
        "comes at 10 Hz). Cut the log there, or state its max_age_seconds if older readings are harmless."
    )
    values = read(log, held_mapping(max_age_seconds=0.4)).values("draw")
    assert np.array_equal(values[50:70], [READINGS[50]] * 20) and values[70] == READINGS[70]
    with pytest.raises(RecordingError, match=r"nothing for 0\.4 s, .* held for up to 0\.05 s"):
        read(log, held_mapping(max_age_seconds=0.05))
    longer = read(log, held_mapping() | {"max_gap_seconds": 0.5})
    assert np.array_equal(longer.values("draw"), values)


def test_a_gauge_that_stops_ends_the_recording_one_period_after_its_last_reading(tmp_path):
    recording = read(a_log(tmp_path, rows(lambda step: step % 5 == 0 and step < 100)), held_mapping())
    assert recording.num_samples == 101  # the last reading is of sample 95, the next was due at 100
    assert recording.notes["ends_before_last_stamp"] == "1.980000 s ('draw' ends first)"


def test_what_the_simulation_has_too_is_not_held(tmp_path):
    mapping = a_mapping()
    mapping["channels"]["joint_torque"]["resample"] = "hold"
    with pytest.raises(
        ConfigError, match=r"joint_torque.resample is hold, but robot 'logger' has .* in simulation too"
    ):
        read(a_log(tmp_path), mapping)


def test_an_age_without_a_reading_that_is_held_is_refused(tmp_path):
    with pytest.raises(ConfigError, match="'draw': max_age_seconds goes with resample: hold, .* by mean; say hold"):
        read(a_log(tmp_path), held_mapping(resample="mean", max_age_seconds=1.0))


def test_a_slow_gauge_that_is_not_held_is_told_to_be_and_no_lower_rate_is_advised(tmp_path):
    log = a_log(tmp_path, rows())
    with pytest.raises(RecordingError, match=r"'draw' was logged at 10 Hz, the mapping wants 50\.") as refused:
        read(log, held_mapping(resample="interpolate"))
    assert "say resample: hold of it" in str(refused.value) and "set rate_hz" not in str(refused.value).lower()


def test_slow_joints_are_not_told_to_be_recorded_below_the_robots_rate(tmp_path):
    """The robot's policy runs at 50 Hz."""
    with pytest.raises(RecordingError, match=r"Log 'joint_torque' at 50 Hz or faster, the rate of the robot's policy"):
        read(a_log(tmp_path, rows(lambda step: True)[::5]), a_mapping())
    with pytest.raises(
        RecordingError, match=r"logged at 50 Hz, the mapping wants 100\. Set rate_hz to 50, the rate of"
    ):
        read(a_log(tmp_path, rows(lambda step: True)), a_mapping(rate_hz=100))


def test_seconds_read_in_another_unit_are_no_slow_gauge(tmp_path):
    mapping = held_mapping() | {"time": {"column": "t", "unit": "s"}}
    del mapping["channels"]["joint_torque"]
    with pytest.raises(RecordingError, match=r"nothing for 100 s, .* held for up to 3 s .* correct time\.unit"):
        read(a_log(tmp_path, rows()), mapping)


def test_the_parts_hold_too():
    slow = held(samples_of("a", [0.0, 0.1, 0.2], [1.0, 2.0, 3.0], "log"))
    fast = samples_of("b", np.arange(30) / 100, np.arange(30), "log")
    grid = common_grid({"a": slow, "b": fast}, 50.0)
    assert resampled(slow, grid, 50.0, "hold")[:, 0].tolist() == [1.0] * 5 + [2.0] * 5 + [3.0] * 5


def test_a_suggestion_holds_a_gauge_that_shows_something_in_few_rows(tmp_path, two_joints):
    for shown, expected in ((lambda step: step % 5 == 0, "hold"), (lambda step: True, None)):
        text = suggested_mapping(a_log(tmp_path, rows(shown)), two_joints)
        assert yaml.safe_load(text)["channels"]["amps"].get("resample") == expected
