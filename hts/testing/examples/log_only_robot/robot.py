"""The robot `logged`: joints, limits, rate and channels, which is what `hts import` and `hts fit` ask for.

Put your machine's numbers here, each with its source beside it. A log whose torques, speeds or positions lie beyond
the limits is refused, so that columns which hold something else are noticed.
"""

from __future__ import annotations

from hts.channels import Channel
from hts.config import Config
from hts.contracts import RobotSpec

JOINTS = ("left", "right")


class Settings(Config):
    """None yet: a key that is not here is refused."""


SPEC = RobotSpec.log_only(
    "logged",
    JOINTS,
    torque_limit=(1.0, 1.0),  # N·m
    velocity_limit=(40.0, 40.0),  # rad/s
    position_limit=((-1e4, 1e4), (-1e4, 1e4)),  # rad; wheels turn for ever
    rate_hz=50.0,
)

CHANNELS = (
    Channel("joint_torque", "N*m", (len(JOINTS),), "torque the motor current makes, seen at the joint"),
    Channel("joint_velocity", "rad/s", (len(JOINTS),), "joint speed"),
)
"""Sim channels: what a model may read. What only the machine gives is named in the mapping, with its idle level."""
