"""What a deploy bundle says of the parts of an observation, of whatever task."""

from __future__ import annotations

from hts.contracts import VELOCITY, Task
from hts.worlds.field_manifest import _part


class Hold(Task):
    """The tip of an arm is held at a height."""

    quantity, unit = "tip height", "m"
    channels = ("tip_height",)
    set_points = (0.1, 0.3)

    def achieved(self, channels):
        return channels["tip_height"]

    def done(self, achieved, set_point, tolerance):
        return abs(achieved - set_point) < 0.05


class Run(Hold):
    """Nothing is commanded."""

    set_points = ()


def told(task: Task, name: str, size: int) -> tuple[str, str]:
    part = _part({"name": name, "size": size}, task, 2)
    return part["unit"], part["meaning"]


def test_a_commanded_velocity_is_told_as_one():
    assert told(VELOCITY, "command", 3) == ("m/s, m/s, rad/s", "vx, vy, yaw rate as sent")
    assert told(VELOCITY, "joint_velocity", 2) == ("rad/s", "joint speed")


def test_what_another_task_commands_is_not_called_a_velocity():
    assert told(Hold(), "command", 1) == ("m", "set-point as sent: the tip height that is wanted")
    assert told(Run(), "command", 1) == ("", "")


def test_of_a_part_of_another_size_only_the_robots_env_knows_what_it_is():
    parts = [(VELOCITY, "command", 2), (Hold(), "command", 3), (Hold(), "joint_velocity", 7)]
    assert {told(*one) for one in parts} == {("", "")}
