"""The trunk's speed by the legs, and speeds in another unit that it tells."""

from __future__ import annotations

import numpy as np
import pytest

from hts import plugins
from hts.channels import Channel
from hts.config import Command, ScheduleConfig
from hts.errors import RecordingError
from hts.recordings import Recording, Series
from hts.recordings.feet import foot_notes
from hts.recordings.leg_speed import leg_speed
from hts.recordings.logs import velocity_notes
from hts.recordings.plausible import check_facts
from hts.recordings.robot_model import robot_model

RATE, SPEED, SWING = 50, 0.5, 0.2  # Hz, m/s, rad
SAMPLES = 8 * RATE


@pytest.fixture(scope="module")
def robot():
    return plugins.load().make_robot("go1")


def walk(robot, trunk_speed=SPEED):
    """Diagonal legs swing in turns about the thigh, the foot straight below it: with links of 0.213 m and a knee bent
    by 1.8 rad the foot is 0.265 m from there, so who stands moves the trunk at 0.265 m times the thigh's rate."""
    reach = 2 * 0.213 * np.cos(0.9)
    half = 2 * SWING / (SPEED / reach)  # s a leg stands
    phase = (np.arange(SAMPLES) / RATE / half)[:, None] + np.array([0.0, 1.0, 1.0, 0.0])  # of each leg, in halves
    forth = phase % 2
    stands = forth < 1
    thigh = 0.9 + SWING * np.where(stands, 2 * forth - 1, 3 - 2 * forth)
    position = np.stack([np.zeros_like(thigh), thigh, np.full_like(thigh, -1.8)], axis=2).reshape(SAMPLES, 12)
    values = {
        "joint_position": ("rad", position),
        "projected_gravity": ("1", np.tile([0.0, 0.0, -1.0], (SAMPLES, 1))),
        "angular_velocity": ("rad/s", np.zeros((SAMPLES, 3))),
        "base_velocity": ("m/s", np.tile([trunk_speed, 0.0, 0.0], (SAMPLES, 1))),
        "foot_force": ("N", 60.0 * stands),
    }
    channels = {
        name: Series(Channel(name, unit, one.shape[1:]), one.astype(np.float64)) for name, (unit, one) in values.items()
    }
    schedule, names = ScheduleConfig(commands=(Command(seconds=SAMPLES / RATE, vx=SPEED),)), robot.spec.joint_names
    time, gains = np.arange(SAMPLES) / RATE, (30.0,) * 12
    return Recording("go1", "field", "", 0, names, gains, gains, RATE, schedule, {}, "log", time, channels)


def test_feet_that_stand_tell_how_fast_the_trunk_goes(robot):
    found = leg_speed(walk(robot), robot).mean(axis=0)
    assert found == pytest.approx([SPEED, 0.0], abs=0.05)


@pytest.mark.parametrize("factor", [3.6, 3.28, 2.237, 1.944])
def test_a_speed_in_another_unit_is_refused_where_the_legs_walk_as_told(robot, factor):
    log = walk(robot, trunk_speed=factor * SPEED)
    with pytest.raises(RecordingError, match=r"01.csv: 'base_velocity' is .* the legs walk at (0.9|1)\S* times them"):
        velocity_notes(log, robot, "01.csv")
    assert velocity_notes(log, robot, "01.csv", stated={"base_velocity"}) == {}


def test_what_the_legs_cannot_tell_is_taken_as_before(robot):
    assert velocity_notes(walk(robot), robot, "01.csv") == {}
    assert velocity_notes(walk(robot, trunk_speed=1.2 * SPEED), robot, "01.csv") == {}
    log = walk(robot, trunk_speed=3.6 * SPEED)
    no_gravity = {name: one for name, one in log.channels.items() if name != "projected_gravity"}
    assert "base_velocity_scale" in velocity_notes(log.replace(channels=no_gravity), robot, "01.csv")
    still = np.zeros((SAMPLES, 12))
    rolls = {**log.channels, "joint_position": Series(log.channels["joint_position"].channel, still)}
    assert "base_velocity_scale" in velocity_notes(log.replace(channels=rolls), robot, "01.csv")


def test_all_that_looks_at_a_log_and_at_the_next_one_shares_one_compiled_model(robot, monkeypatch):
    """Built twice: to see whether there is one, and to compile it."""
    machine, built = type(robot)(robot.settings), []
    make = machine.mjcf
    monkeypatch.setattr(machine, "mjcf", lambda: built.append(1) or make())
    log = walk(machine).replace(mass_kg=12.7)
    for _ in range(2):
        check_facts(log, machine, "01.csv")
        assert leg_speed(log, machine) is not None and foot_notes(log, machine) == {}
    assert len(built) == 2
    assert foot_notes(log, robot) == {} and len(built) == 2  # another robot has its own
    assert robot_model(machine).ngeom == robot_model(robot).ngeom and robot_model(robot) is not robot_model(machine)
