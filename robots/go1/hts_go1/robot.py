"""The robot `go1` as hts sees it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from pydantic import BaseModel, ConfigDict, Field

from hts.channels import Channel, standard_channels
from hts.contracts import JointMotors, RobotSpec
from hts.envs.velocity_robot import VelocityRobot
from hts_go1 import constants as c

if TYPE_CHECKING:
    from dm_control.mjcf import RootElement

POLICIES = Path(__file__).parent / "policies"


class Go1Settings(BaseModel):
    """Settings of the robot `go1`."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    policy: Path | None = Field(None, description="a pretrained policy (.safetensors) instead of the shipped one")


def per_joint(values: Mapping[str, float]) -> tuple[float, ...]:
    """One value per joint, in joint order, from one per part."""
    return tuple(values[part] for _ in c.LEGS for part in c.PARTS)


SPEC = RobotSpec(
    name="go1",
    joint_names=c.JOINT_NAMES,
    default_pose=per_joint(c.DEFAULT_POSE),
    kp=(c.KP,) * 12,
    kd=(c.KD,) * 12,
    action_scale=(c.ACTION_SCALE,) * 12,
    torque_limit=per_joint(c.TORQUE_LIMIT),
    velocity_limit=per_joint(c.VELOCITY_LIMIT),
    position_limit=tuple(c.POSITION_LIMIT[part] for _ in c.LEGS for part in c.PARTS),
    control_rate_hz=c.CONTROL_RATE_HZ,
    physics_dt=c.PHYSICS_DT,
    substeps=c.SUBSTEPS,
    base_height=c.BASE_HEIGHT,
    trunk_body="trunk",
    foot_sites=tuple(f"{leg}_foot" for leg in c.LEGS),
    endurance_minutes=60.0,  # GO1 User Manual V1.4, battery table: "about 1 h"
    motors=JointMotors(
        torque_constant=per_joint(c.TORQUE_CONSTANT),
        gear_ratio=per_joint(c.GEAR_RATIO),
        phase_resistance_ohm=(c.PHASE_RESISTANCE_OHM,) * 12,
    ),
)


class Go1(VelocityRobot):
    """Unitree Go1: 12 joints, 13.1 kg, velocity task."""

    spec = SPEC
    bundle_commands = (
        "python -m hts_go1_runtime check .  # nothing moves",
        "python -m hts_go1_runtime run . --link udp://127.0.0.1:9870 --first-run  # new policies: slowly, weakly",
        "python -m hts_go1_runtime run . --link udp://127.0.0.1:9870  # Enter: stop; s, Enter: sit; --straight 4: 4 m",
    )

    def __init__(self, settings: Go1Settings) -> None:
        self.settings = settings

    def mjcf(self) -> RootElement:
        """A fresh MJCF tree of robot and floor."""
        from hts_go1.model import build

        return build()

    def channels(self) -> Mapping[str, Channel]:
        """Sim channels of a Go1: 12 joints, 4 feet."""
        return standard_channels(num_joints=12, num_feet=4)

    def pretrained_policy(self) -> Path | None:
        """The shipped policy, or the one of the settings."""
        return self.settings.policy or POLICIES / "pretrained.safetensors"
