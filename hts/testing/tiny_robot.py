"""A robot of two joints and two feet, with numbers but no model: enough to try objectives and instruments on."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from hts.channels import Channel, standard_channels
from hts.contracts import JointMotors, Robot, RobotSpec

SPEC = RobotSpec(
    name="tiny",
    joint_names=("left", "right"),
    default_pose=(0.0, 0.0),
    kp=(20.0, 20.0),
    kd=(0.5, 0.5),
    action_scale=(0.25, 0.25),
    torque_limit=(20.0, 20.0),
    velocity_limit=(30.0, 30.0),
    position_limit=((-1.0, 1.0), (-1.0, 1.0)),
    control_rate_hz=50.0,
    physics_dt=0.005,
    substeps=4,
    base_height=0.3,
    foot_sites=("left_foot", "right_foot"),
    motors=JointMotors(torque_constant=(0.6, 0.6), gear_ratio=(6.0, 9.0), phase_resistance_ohm=(0.2, 0.2)),
)


class TinyRobot(Robot):
    """Log-only: a spec and channels."""

    spec = SPEC

    def mjcf(self) -> Any | None:
        return None

    def channels(self) -> Mapping[str, Channel]:
        return standard_channels(self.spec.num_joints, len(self.spec.foot_sites))

    def pretrained_policy(self) -> Path | None:
        return None
