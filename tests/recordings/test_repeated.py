"""Values that a logger repeats while the robot moves on are told with their times."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from two_joint_log import TWO_JOINTS

from hts.channels import Channel
from hts.recordings import Series
from hts.recordings.logs import recording_from_columns, repeated_notes

TIMES = np.arange(500) / 50
UNITS = {"joint_target": "rad", "joint_position": "rad", "joint_velocity": "rad/s", "joint_torque": "N*m"}


def walk():
    """Hip and knee swing at 2 and 2.6 Hz, for 10 s."""
    rates = 2 * np.pi * np.array([2.0, 2.6])
    phase = TIMES[:, None] * rates
    position, target = 0.3 * np.sin(phase), 0.4 * np.sin(phase + 0.3)
    velocity = 0.3 * rates * np.cos(phase)
    return {
        "joint_target": target,
        "joint_position": position,
        "joint_velocity": velocity,
        "joint_torque": 20 * (target - position) - 0.5 * velocity,
    }


def notes(values):
    return repeated_notes({name: Series(Channel(name, UNITS[name], (2,)), one) for name, one in values.items()}, 50.0)


def repeating(name, *stretches, values=None):
    values = dict(walk() if values is None else values)
    one = values[name].copy()
    for first, last in stretches:
        one[first : last + 1] = one[first]
    return {**values, name: one}


def test_a_walk_says_nothing():
    assert notes(walk()) == {}


@pytest.mark.parametrize("name", ["joint_target", "joint_position", "joint_velocity", "joint_torque"])
def test_a_channel_that_repeats_itself_while_the_joints_move_is_told_with_its_times(name):
    told = notes(repeating(name, (100, 125), (300, 340)))["repeated_while_moving"]
    assert told.startswith(f"{name} from 2.00 to 2.50 s, 6.00 to 6.80 s: the same for all joints while they move")


def test_it_is_told_without_velocities_too_and_only_of_the_first_three_times():
    values = repeating("joint_target", *((at, at + 15) for at in range(50, 450, 50)))
    del values["joint_velocity"]
    told = notes(values)["repeated_while_moving"]
    assert "1.00 to 1.30 s, 2.00 to 2.30 s, 3.00 to 3.30 s and 5 times more: " in told


def test_a_policy_that_is_slower_than_the_log_or_one_joint_alone_says_nothing():
    values = walk()
    assert notes({**values, "joint_target": np.repeat(values["joint_target"][::5], 5, axis=0)}) == {}
    one = values["joint_target"].copy()
    one[100:200, 0] = one[100, 0]
    assert notes({**values, "joint_target": one}) == {}


def test_who_stands_or_is_let_go_has_targets_that_stay():
    values = walk()
    for speed in (0.0, 0.2):  # of the walk's
        slow = {name: one.copy() for name, one in values.items()}
        slow["joint_position"][250:] *= speed
        slow["joint_velocity"][250:] *= speed
        assert notes(repeating("joint_target", (250, 499), values=slow)) == {}


def test_an_import_says_it():
    values = repeating("joint_target", (100, 125))
    columns = {"t": 1000 * TIMES}
    for name, one in values.items():
        columns |= {f"{joint}_{name}": one[:, at] for at, joint in enumerate("HK")}
    mapping = {
        "time": {"column": "t", "unit": "ms"},
        "rate_hz": 50,
        "joints": {"hip": "H", "knee": "K"},
        "channels": {name: {"columns": f"{{joint}}_{name}", "unit": UNITS[name]} for name in values},
    }
    made = recording_from_columns([Path("log")], mapping, TWO_JOINTS, lambda path: columns)
    assert "joint_target from 2.00 to 2.50 s" in made.notes["repeated_while_moving"]
