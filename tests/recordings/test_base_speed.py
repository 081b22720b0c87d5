"""Velocities of the trunk that are not those of a robot which walked as it was told."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hts.channels import Channel
from hts.config import Command, ScheduleConfig
from hts.contracts import LogOnlyRobot, RobotSpec
from hts.errors import RecordingError
from hts.recordings import Recording, Series
from hts.recordings.logs import recording_from_columns, velocity_notes

RATE = 50
COMMANDS = (
    (5.0, 0.0, 0.0, 0.0),
    (8.0, 0.8, 0.0, 0.0),
    (8.0, 0.5, 0.0, 0.5),
    (8.0, 0.4, 0.2, 0.0),
)  # s, vx, vy, yaw rate
SECONDS = sum(command[0] for command in COMMANDS)
LEGGED = LogOnlyRobot(
    RobotSpec.log_only(
        "walker", ["hip"], torque_limit=[20.0], velocity_limit=[30.0], position_limit=[(-3.0, 3.0)], rate_hz=RATE
    ),
    [Channel("base_velocity", "m/s", (3,)), Channel("command", "1", (3,))],
)


def told(commands=COMMANDS):
    return np.concatenate([np.tile(command[1:], (int(command[0] * RATE), 1)) for command in commands])


def walked(pace=0.9, commands=COMMANDS):
    """(T, 3) m/s: slower than told, with the sway of steps."""
    wanted = told(commands)
    velocity = np.column_stack([pace * wanted[:, :2], np.zeros(len(wanted))])
    steps = np.arange(len(wanted))[:, None] / RATE * 2 * np.pi * [2.0, 1.0, 2.0]
    return velocity + [0.1, 0.2, 0.1] * np.sin(steps)


def recording(velocity, commands=COMMANDS, logged=False, **changes):
    channels = {"base_velocity": Series(Channel("base_velocity", "m/s", (3,)), velocity)}
    if logged:
        channels["command"] = Series(Channel("command", "1", (3,)), told(commands))
    schedule = ScheduleConfig(
        commands=tuple(Command(seconds=s, vx=vx, vy=vy, yaw_rate=yaw) for s, vx, vy, yaw in commands)
    )
    time = np.arange(len(velocity)) / RATE
    made = Recording("walker", "field", "", 0, ("hip",), (0.0,), (0.0,), RATE, schedule, {}, "log", time, channels)
    return made.replace(**changes)


def in_world(velocity):
    """What motion capture shows of a robot that was put down at 100 degrees, heading where its yaw rate leads it."""
    heading = np.radians(100) + np.cumsum(told()[:, 2]) / RATE
    x, y = velocity[:, 0], velocity[:, 1]
    turned = x * np.cos(heading) - y * np.sin(heading), x * np.sin(heading) + y * np.cos(heading)
    return np.column_stack([*turned, velocity[:, 2]])


@pytest.mark.parametrize("logged", [False, True])
@pytest.mark.parametrize("pace", [0.5, 0.9, 1.8])
def test_who_walks_as_told_passes_slow_or_fast(pace, logged):
    assert velocity_notes(recording(walked(pace), logged=logged), LEGGED, "log") == {}


@pytest.mark.parametrize("logged", [False, True])
@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (lambda v: 1000 * v, "more than the 100 m/s of any such robot. It is probably in another unit"),
        (lambda v: 100 * v, "times as fast as the commands. It is probably in another unit"),
        (lambda v: -v, "does not lie in the commanded direction .*counted the other way .sign: -1."),
        (lambda v: v[:, [1, 0, 2]], "does not lie in the commanded direction .*forward and sideways were swapped"),
        (in_world, "does not lie in the commanded direction .*in the axes of the world. Expected is that of the trunk"),
    ],
)
def test_another_unit_sign_or_axes_are_refused(change, expected, logged):
    made = recording(change(walked()), logged=logged)
    with pytest.raises(RecordingError, match=f"log: 'base_velocity' .*{expected}") as refused:
        velocity_notes(made, LEGGED, "log")
    assert "\n" not in str(refused.value) and str(refused.value).endswith("say so with `limits`.")
    assert velocity_notes(made, LEGGED, "log", stated=["base_velocity"]) == {}
    assert velocity_notes(made.replace(fell=True), LEGGED, "log") == {}


@pytest.mark.parametrize(("factor", "shown"), [(3.6, "3.2 times"), (1 / 3.6, "0.25 times"), (0.0, "0 times")])
def test_much_faster_or_slower_than_told_is_noted(factor, shown):
    notes = velocity_notes(recording(factor * walked()), LEGGED, "log")
    assert list(notes) == ["base_velocity_scale"] and notes["base_velocity_scale"].startswith(shown)


def test_who_was_told_to_stand_or_for_a_moment_or_by_nobody_says_nothing():
    backwards = -walked()
    for commands in (((SECONDS, 0.1, 0.0, 0.0),), ((1.0, 0.8, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0))):
        assert velocity_notes(recording(backwards, commands), LEGGED, "log") == {}
    unsaid = recording(backwards, notes={"schedule": "not stated in the mapping"})
    assert velocity_notes(unsaid, LEGGED, "log") == {}


@pytest.mark.parametrize("start", [0.0, 100.0])
def test_a_schedule_begins_with_the_first_sample_whatever_the_clock_says(start):
    commands = ((10.0, 0.8, 0.0, 0.0), (10.0, 0.0, 0.0, 0.0))
    made = recording(-walked(commands=commands), commands)
    with pytest.raises(RecordingError, match="counted the other way"):
        velocity_notes(made.replace(time=start + made.time), LEGGED, "log")


def test_a_robot_that_was_told_to_walk_backwards_or_sideways_passes():
    for vx, vy in ((-0.5, 0.0), (0.0, 0.4)):
        commands = ((10.0, vx, vy, 0.0),)
        assert velocity_notes(recording(walked(commands=commands), commands), LEGGED, "log") == {}


def test_an_import_refuses_and_notes():
    def imported(factor, **one):
        values = factor * walked()
        columns = {"t": np.arange(len(values)) / RATE, "vx": values[:, 0], "vy": values[:, 1], "vz": values[:, 2]}
        commands = [{"seconds": s, "vx": vx, "vy": vy, "yaw_rate": yaw} for s, vx, vy, yaw in COMMANDS]
        mapping = {
            "time": {"column": "t", "unit": "s"},
            "rate_hz": RATE,
            "channels": {"base_velocity": {"columns": ["vx", "vy", "vz"], "unit": "m/s", **one}},
            "recording": {"schedule": {"commands": commands}},
        }
        return recording_from_columns([Path("log")], mapping, LEGGED, lambda path: columns)

    assert "base_velocity_scale" not in imported(1.0).notes
    assert "base_velocity_scale" in imported(3.6).notes
    assert "base_velocity_scale" not in imported(1.0, sign=1).notes
    with pytest.raises(RecordingError, match="log: 'base_velocity' does not lie in the commanded direction"):
        imported(-1.0)
    assert imported(-1.0, limits=[-3, 3]).num_samples == SECONDS * RATE
