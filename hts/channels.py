"""Channels: named time series with a unit and a shape, the common tongue of simulation, robots and models."""

from __future__ import annotations

from dataclasses import dataclass
from numbers import Integral

from hts import units
from hts.errors import RecordingError


@dataclass(frozen=True, slots=True)
class Channel:
    """One named time series.

    name: as recordings and models ask for it; unit: of every number, see `hts.units`; shape: of a single sample, ()
    for a scalar; description: for the reader of a table; may_be_constant: for quantities that may honestly stand still
    during a recording, such as a temperature or a state of charge.

    Raises RecordingError for a unit that nobody knows, and for a shape that is no tuple of whole numbers.
    """

    name: str
    unit: str
    shape: tuple[int, ...] = ()
    description: str = ""
    may_be_constant: bool = False

    def __post_init__(self) -> None:
        if not units.known(self.unit):
            raise RecordingError(f"Channel '{self.name}': {units.unknown(self.unit)}")
        sizes = self.shape if isinstance(self.shape, tuple) else (None,)
        if not all(isinstance(size, Integral) and size >= 0 for size in sizes):
            raise RecordingError(
                f"Channel '{self.name}': shape is {self.shape!r}, expected a tuple of whole numbers: () where a "
                "sample is one number, (12,) where it is twelve."
            )


SPEED_ERROR = Channel(
    "speed_error", "1", (), "speed along the command over the commanded one, less 1; 0 where it does not count"
)
"""What training holds at zero on average; made in simulation only."""

SPEED_ERROR_TREND = Channel(
    "speed_error_trend",
    "1",
    (),
    "speed_error times where the command lies in its range, from -1 (slowest) to 1 (fastest)",
)
"""Held at zero on average, too: else a policy that walks at one speed whatever it is told has no error on average."""

_MISSED = (
    "how far the speed of about a second is from the robot's own of some seconds, and its own from the command beyond "
    "a quarter, as shares of the command and 1 at most; of commands in the {} half of their range, 0 where it does not "
    "count"
)
SPEED_MISSED_SLOW = Channel("speed_missed_slow", "1", (), _MISSED.format("slower"))
SPEED_MISSED_FAST = Channel("speed_missed_fast", "1", (), _MISSED.format("faster"))
"""Kept low on average: else a policy stands at slow commands and walks too fast at others, or stands and hurries in
turn, without an error on average. A machine a little faster than the next is not meant: its command is trimmed."""

MISSED_CHANNELS = (SPEED_MISSED_SLOW, SPEED_MISSED_FAST)
HELD_CHANNELS = {channel.name: channel for channel in (SPEED_ERROR, SPEED_ERROR_TREND, *MISSED_CHANNELS)}
"""Made by the env of the velocity task, beside the channels of its robot."""


SUBSTEP_TORQUE, SUBSTEP_VELOCITY, SUBSTEP_FORCE = "substep_torque", "substep_velocity", "substep_force"


def substep_channels(substeps: int, num_joints: int, num_feet: int) -> dict[str, Channel]:
    """What the K physics steps of a control step were like, which its end does not show: a joint's torque jumps where
    its target does. Made by the env of the velocity task when asked for, beside the channels of its robot, on engines
    that keep them (`Engine.physics_steps`)."""
    joints = (substeps, num_joints)
    channels = (
        Channel(SUBSTEP_TORQUE, "N*m", joints, "joint torque in each physics step"),
        Channel(SUBSTEP_VELOCITY, "rad/s", joints, "joint speed, mean of before and after each physics step"),
        Channel(SUBSTEP_FORCE, "N", (substeps, num_feet), "normal force under each foot in each physics step"),
    )
    return {channel.name: channel for channel in channels}


def standard_channels(num_joints: int, num_feet: int) -> dict[str, Channel]:
    """The sim channels of a legged robot: what simulation and robot both give.

    num_joints: J, in the robot's joint order; num_feet: F, in the robot's foot order.
    """
    joints, feet = (num_joints,), (num_feet,)
    channels = (
        Channel("joint_position", "rad", joints, "joint angle"),
        Channel("joint_velocity", "rad/s", joints, "joint speed"),
        Channel("joint_torque", "N*m", joints, "torque the motor current makes, seen at the joint"),
        Channel("joint_target", "rad", joints, "position target sent to the joint controller"),
        Channel("angular_velocity", "rad/s", (3,), "of the trunk, in the trunk frame"),
        Channel("projected_gravity", "1", (3,), "unit vector of gravity in the trunk frame"),
        Channel("base_velocity", "m/s", (3,), "of the trunk, in the trunk frame (x forward)"),
        Channel("command", "1", (3,), "commanded vx m/s, vy m/s, yaw rate rad/s", may_be_constant=True),
        Channel("foot_force", "N", feet, "normal force under each foot"),
    )
    return {channel.name: channel for channel in channels}
