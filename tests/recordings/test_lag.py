"""How late a gauge is, from recordings alone."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from hts.cli.data_use import show_enough
from hts.errors import RecordingError
from hts.measurement.wanted import Wanted
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


@pytest.fixture
def slow_hip(mapping, two_joints):
    """A recording whose hip moves slowly, so that a lag of 1 s explains something of one of 1.2 s; late: samples."""

    def read(late):
        random = np.random.default_rng(0)
        hip = np.convolve(random.normal(size=3000), np.ones(30) / 5, "same")
        columns = {"t": 20 * np.arange(2800), "H_tau": hip[100:2900], "K_tau": hip[100:2900] / 3}
        columns["amps"] = 2 + np.abs(hip[100 - late : 2900 - late])
        return recording_from_columns([Path("log")], mapping, two_joints, lambda path: columns)

    return read


@pytest.mark.parametrize(
    ("late", "expected"),
    [(-17, "-0.34 s.*it shows what comes.*another clock"), (60, "1 s is the longest that is tried")],
)
def test_a_gauge_that_is_early_or_later_than_is_tried_is_not_told_another_lag(slow_hip, late, expected):
    found = gauge_lag([slow_hip(late)], "draw", ["joint_torque"])
    assert found is not None and re.search(expected, str(found))


@pytest.mark.parametrize(("late", "told"), [(-17, True), (5, False)])
def test_recordings_with_a_gauge_that_is_early_are_not_enough(slow_hip, store, late, told):
    store.write(slow_hip(late))
    lines, is_enough = show_enough(store.path, None, Wanted("draw", ("joint_torque",)), (), as_json=False)
    assert any("'draw' is early by 0.34 s" in line for line in lines if line.startswith("missing")) == told
    assert not is_enough  # there is one policy only


def test_a_steady_gait_is_not_early_one_stride_before(mapping, two_joints):
    step = np.arange(1500)
    hip = 5 * np.sin(2 * np.pi * step / 25) + 0.01 * np.random.default_rng(0).normal(size=1500)
    columns = {"t": 20 * step, "H_tau": hip, "K_tau": hip / 3, "amps": 2 + np.abs(np.roll(hip, 5))}
    found = gauge_lag(
        [recording_from_columns([Path("log")], mapping, two_joints, lambda path: columns)], "draw", ["joint_torque"]
    )
    assert found is not None and found.low >= 0


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
