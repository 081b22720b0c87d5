"""Torques, or velocities, counted the other way show in the work of joints that come back to where they began."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from walker_recording import a_recording

from hts.channels import Channel
from hts.contracts import LogOnlyRobot, RobotSpec
from hts.recordings import Series
from hts.recordings.csv_reader import make
from hts.recordings.joint_work import work_notes

LOGS = Path(os.environ.get("HTS_REAL_LOGS", Path(__file__).parents[3] / "shared" / "real-logs"))
COUNT = 500  # 10 s at 50 Hz, ten times to and fro
PHASE = 2 * np.pi * np.arange(COUNT) / 50


def moved(torque, speed, **changes):
    """Both joints alike; torque N·m and speed rad/s, (COUNT,)."""
    both = {"joint_torque": ("N*m", torque), "joint_velocity": ("rad/s", speed)}
    channels = {
        name: Series(Channel(name, unit, (2,)), np.stack([values, values], axis=1).astype(np.float32))
        for name, (unit, values) in both.items()
    }
    return a_recording(COUNT).replace(channels=channels, **changes)


def test_joints_that_take_what_they_should_give_are_told():
    """By hand: -2 cos x 4 cos is -4 W on average for each joint, all of it taken."""
    found = work_notes(moved(-2 * np.cos(PHASE), 4 * np.cos(PHASE)))
    assert list(found) == ["joint_torque_takes_work"]
    assert "is -8 W in the mean (-100% of what passes through them)" in found["joint_torque_takes_work"]


@pytest.mark.parametrize(
    ("torque", "speed", "changes"),
    [
        (2 * np.cos(PHASE), 4 * np.cos(PHASE), {}),  # they do work
        (2 * np.sin(PHASE), 4 * np.cos(PHASE), {}),  # a spring
        (-2 * np.cos(PHASE), 0.5 * np.cos(PHASE), {}),  # hardly moving
        (np.full(COUNT, -2.0), np.full(COUNT, 1.5), {}),  # let down, and left there
        (-2 * np.cos(PHASE), 4 * np.cos(PHASE), {"fell": True}),
    ],
)
def test_nothing_is_said_of_others(torque, speed, changes):
    assert work_notes(moved(torque, speed, **changes)) == {}


def test_a_persons_word_counts():
    assert work_notes(moved(-2 * np.cos(PHASE), 4 * np.cos(PHASE)), stated=["joint_torque"]) == {}


@pytest.mark.skipif(not LOGS.is_dir(), reason="real logs are not here; HTS_REAL_LOGS names their folder")
@pytest.mark.parametrize("log", ["walking5", "back_both_wire2"])
@pytest.mark.parametrize("sign", [1, -1])
def test_a_real_walk_does_work_and_reversed_it_is_told(log, sign):
    joints = tuple(f"{leg}_{part}" for leg in ("FL", "FR", "RL", "RR") for part in ("hip", "thigh", "calf"))
    limits = {"torque_limit": [45.0] * 12, "velocity_limit": [30.0] * 12, "position_limit": [(-3.0, 3.0)] * 12}
    units = {"joint_velocity": "rad/s", "joint_torque": "N*m"}
    channels = [Channel(name, unit, (12,)) for name, unit in units.items()]
    robot = LogOnlyRobot(RobotSpec.log_only("real", joints, **limits, rate_hz=50), channels)
    given = {
        "time": {"column": "timestamp", "unit": "s"},
        "rate_hz": 50,
        "channels": {
            "joint_velocity": {"columns": "{joint}_dq", "unit": "rad/s"},
            "joint_torque": {"columns": "{joint}_tau", "unit": "N*m", "sign": sign},
        },
    }
    recording = make({}).read([LOGS / "go2_walk" / f"{log}.csv"], given, robot)
    assert ("joint_torque_takes_work" in recording.notes) == (sign == -1)
