"""Velocities that are not those of the positions: swapped, in another order, sign or unit."""

from __future__ import annotations

import numpy as np
import pytest

from hts.channels import Channel
from hts.errors import RecordingError
from hts.recordings import Series
from hts.recordings.logs import check_motion, recording_from_columns

TIMES = np.arange(300) / 50


def moving(**changes):
    """Hip and knee swing at 0.5 and 0.8 Hz: position, rad, and its derivative, with noise."""
    rates = 2 * np.pi * np.array([0.5, 0.8])
    noise = np.random.default_rng(0).normal(0, 0.2, (300, 2))
    found = {"joint_position": 0.5 * np.sin(TIMES[:, None] * rates)}
    found["joint_velocity"] = 0.5 * rates * np.cos(TIMES[:, None] * rates) + noise
    found |= {name: change(found) for name, change in changes.items()}
    units = {"joint_position": "rad", "joint_velocity": "rad/s"}
    return {name: Series(Channel(name, units[name], (2,)), values) for name, values in found.items()}


def test_velocities_that_are_the_slope_pass(two_joints):
    check_motion(moving(), two_joints.spec, 50.0, "log")


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (lambda v: -v["joint_velocity"], "counted the other way: say sign: -1"),
        (lambda v: v["joint_velocity"] * 57.3, "times the slope of the positions: one of them is in another unit"),
        (
            lambda v: v["joint_velocity"][:, ::-1],
            "the position of hip moves as the velocity of knee says .*different joint orders",
        ),
        (lambda v: v["joint_position"] * 9, "the columns are probably others than the mapping says"),
    ],
)
def test_others_are_refused_with_what_they_look_like(two_joints, change, expected):
    channels = moving(joint_velocity=change)
    with pytest.raises(
        RecordingError, match=f"log: 'joint_velocity' is not how fast 'joint_position' changes.*{expected}"
    ):
        check_motion(channels, two_joints.spec, 50.0, "log")
    check_motion(channels, two_joints.spec, 50.0, "log", stated=["joint_velocity"])


def test_what_stands_still_or_is_short_tells_nothing(two_joints):
    still = moving(joint_position=lambda v: 0 * v["joint_position"])
    check_motion(still, two_joints.spec, 50.0, "log")
    short = {name: Series(one.channel, -one.values[:20]) for name, one in moving().items()}
    check_motion({**short, "joint_position": moving()["joint_position"]}, two_joints.spec, 50.0, "log")


def test_columns_swapped_in_a_log_are_noticed(tmp_path, two_joints, mapping):
    values = {name: one.values for name, one in moving().items()}
    columns = {"t": 1000 * TIMES}
    columns |= {f"{j}_q": values["joint_position"][:, at] for at, j in enumerate("HK")}
    columns |= {f"{j}_dq": values["joint_velocity"][:, at] for at, j in enumerate("HK")}
    mapping["channels"] = {
        "joint_position": {"columns": "{joint}_dq", "unit": "rad"},
        "joint_velocity": {"columns": "{joint}_q", "unit": "rad/s"},
    }
    with pytest.raises(RecordingError, match="log: 'joint_velocity' is not how fast"):
        recording_from_columns([tmp_path / "log"], mapping, two_joints, lambda path: columns)
