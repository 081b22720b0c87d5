"""How late a gauge is, from recordings alone."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hts.errors import RecordingError
from hts.recordings.lag import gauge_lag
from hts.recordings.logs import recording_from_columns


def recorded(mapping, robot, late_samples, seconds=30.0, seed=0, still=False):
    """A gauge that shows 2 + |torque of the hip| + noise, late by whole samples of 20 ms."""
    random = np.random.default_rng(seed)
    count = round(seconds * 50)
    hip = np.convolve(random.normal(size=count + 40), np.ones(5) / 5, "same")
    amps = 2 + np.abs(hip) * (not still) + 0.02 * random.normal(size=len(hip))
    columns = {"t": 20 * np.arange(count), "H_tau": hip[40:], "K_tau": hip[40:] / 3}
    columns["amps"] = amps[40 - late_samples : len(hip) - late_samples]
    return recording_from_columns([Path("log")], mapping, robot, lambda path: columns)


@pytest.fixture
def read(mapping, two_joints):
    return lambda *given, **more: recorded(mapping, two_joints, *given, **more)


@pytest.mark.parametrize("late", [0, 3, 17])
def test_the_lag_is_found_to_a_sample(read, late):
    found = gauge_lag([read(late), read(late, seed=1)], "draw", ["joint_torque"])
    assert found.seconds == pytest.approx(late / 50)
    assert found.low <= found.seconds <= found.high <= found.low + 0.04
    assert found.r2 > 0.9 and (late == 0 or found.r2 - found.r2_at_zero > 0.1)
    assert f"{late / 50:.3g} s" in str(found)


def test_standing_still_tells_no_lag(read):
    assert gauge_lag([read(3, still=True)], "draw", ["joint_torque"]) is None


def test_what_cannot_tell_a_lag_is_one_line(read):
    with pytest.raises(RecordingError, match="No recording lasts 5 s"):
        gauge_lag([read(3, seconds=4.0)], "draw", ["joint_torque"])
    with pytest.raises(RecordingError, match="No channel named 'drew'. Did you mean 'draw'"):
        gauge_lag([read(3)], "drew", ["joint_torque"])
    with pytest.raises(RecordingError, match=r"'joint_torque' has shape \(2,\) a sample"):
        gauge_lag([read(3)], "joint_torque", ["draw"])
    with pytest.raises(RecordingError, match="No recordings"):
        gauge_lag([], "draw", ["joint_torque"])
