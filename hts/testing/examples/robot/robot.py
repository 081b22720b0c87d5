"""The robot `tiny`: its numbers, its channels, its first policy. The body is in `model`.

A cart on two driven wheels, made up so that everything runs before your own machine is described. Put your numbers
into SPEC, each with its source beside it, and your model into `model.build`. A policy belongs to the numbers that it
was made with: once they change, `hts pretrain --robot tiny --out DIR` makes another one.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from pydantic import Field

from hts.channels import Channel, standard_channels
from hts.config import Config
from hts.contracts import JointMotors, RobotSpec
from hts.envs.velocity_robot import VelocityRobot

POLICY = Path(__file__).parent / "policies" / "pretrained.safetensors"

SPEC = RobotSpec(
    name="tiny",
    joint_names=("left", "right"),
    default_pose=(0.0, 0.0),  # rad
    kp=(0.1, 0.1),  # N·m/rad; soft, so that with the damping it drives at a speed. A leg's is 20 to 100
    kd=(1.0, 1.0),  # N·m·s/rad
    action_scale=(12.5, 12.5),  # rad per action unit, worth 1.25 N·m; a leg's is 0.25 or so
    torque_limit=(1.0, 1.0),  # N·m; two wheels of 0.08 m then push with 25 N, below the floor's grip
    velocity_limit=(40.0, 40.0),  # rad/s, without load
    position_limit=((-1e4, 1e4), (-1e4, 1e4)),  # rad; wheels turn for ever
    control_rate_hz=50.0,
    physics_dt=0.005,
    substeps=4,
    base_height=0.08,  # m, of the trunk's frame: the axle
    trunk_body="trunk",
    foot_sites=("left_foot", "right_foot"),
    endurance_minutes=None,  # of walking on one charge, if it is known: for `hts run --dry-run`
    motors=JointMotors(torque_constant=(0.05, 0.05), gear_ratio=(1.0, 1.0), phase_resistance_ohm=(0.2, 0.2)),
)


class Settings(Config):
    """Settings of the robot: `--set robot.policy=FILE`."""

    policy: Path | None = Field(None, description="a pretrained policy (.safetensors) instead of the shipped one")


class Tiny(VelocityRobot):
    """The machine, as hts sees it."""

    spec = SPEC

    def __init__(self, settings: Settings | None = None) -> None:
        self.settings = settings or Settings()

    def mjcf(self):
        """A fresh MJCF tree of robot and floor."""
        from hts.testing.examples.robot.model import build

        return build()

    def channels(self) -> Mapping[str, Channel]:
        return standard_channels(self.spec.num_joints, len(self.spec.foot_sites))

    def pretrained_policy(self) -> Path | None:
        return self.settings.policy or POLICY

    def make_env(self, engine, num_candidates, num_envs, config, channels=(), seeds=None):
        """The velocity task, without its pull towards the default pose: wheels have none. Legs want it: delete this."""
        weights = {"pose": 0.0, **config.reward_weights}
        changed = config.model_copy(update={"reward_weights": weights})
        return super().make_env(engine, num_candidates, num_envs, changed, channels, seeds)
