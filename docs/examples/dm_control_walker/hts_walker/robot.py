"""The robot `dm_walker`: the suite's planar walker. Numbers from dm_control/suite/walker.xml and walker.py, 1.0.50."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import radians
from pathlib import Path

from hts.channels import Channel
from hts.config import Config, EnvConfig
from hts.contracts import Robot, RobotSpec, Task
from hts.errors import ConfigError

LEAST_SPEED = 0.9
"""m/s, over a second. The suite rewards 1 m/s and everything above alike, so a second that is about as fast counts."""

OBSERVATION = (("orientations", 14), ("height", 1), ("velocity", 9))
"""Parts of the suite's observation, in its order: cos and sin of 7 bodies, torso height m, qvel m/s and rad/s."""

JOINTS = ("right_hip", "right_knee", "right_ankle", "left_hip", "left_knee", "left_ankle")
GEAR = (100.0, 50.0, 20.0) * 2  # N*m for a control of 1

SPEC = RobotSpec(
    name="dm_walker",
    joint_names=JOINTS,
    default_pose=(0.0, -0.1, 0.0) * 2,  # about upright; nothing is held there: the walker is driven by torque
    kp=(0.0,) * 6,
    kd=(0.0,) * 6,
    action_scale=(1.0,) * 6,  # an action is a control in [-1, 1], not a joint target
    torque_limit=GEAR,
    velocity_limit=(60.0,) * 6,  # none in the model; a bound for checks of logs
    position_limit=((radians(-20), radians(100)), (radians(-150), 0.0), (radians(-45), radians(45))) * 2,
    control_rate_hz=40.0,
    physics_dt=0.0025,
    substeps=10,
    base_height=1.3,
    trunk_body="torso",
)

CHANNELS = (
    Channel("joint_torque", "N*m", (6,), "control times gear"),
    Channel("joint_velocity", "rad/s", (6,)),
    Channel("base_velocity", "m/s", (3,), "of the torso: forward, 0, up"),
    Channel("projected_gravity", "1", (3,), "unit vector of gravity in the torso's frame"),
)


class Settings(Config):
    """Settings of the robot; it has none."""


class WalkForward(Task):
    """The suite's `walker-walk`: get forward at 1 m/s or more. Nothing is commanded."""

    quantity, unit = "forward speed", "m/s"
    channels = ("base_velocity",)
    set_points = ()

    def achieved(self, channels):
        return channels["base_velocity"][..., 0]

    def done(self, achieved, set_point, tolerance):
        return achieved > LEAST_SPEED


class Walker(Robot):
    """A machine whose environment is somebody else's. No MJCF is given: only the core's own task would read it."""

    spec = SPEC

    def __init__(self, settings: Settings) -> None:
        self.settings = settings

    def mjcf(self) -> None:
        return None

    def task(self) -> Task:
        return WalkForward()

    def channels(self) -> Mapping[str, Channel]:
        return {channel.name: channel for channel in CHANNELS}

    def pretrained_policy(self) -> Path:
        return Path(__file__).parent / "policies" / "pretrained.safetensors"

    def make_env(
        self,
        engine: str,
        num_candidates: int,
        num_envs: int,
        config: EnvConfig,
        channels: Sequence[str] = (),
        seeds: Sequence[int] | None = None,
    ):
        """The suite's task, [num_candidates, num_envs] of it. Of `config` it reads the time-out and the seed."""
        if engine != "mujoco":
            raise ConfigError(
                f"Robot 'dm_walker' runs on engine 'mujoco', not '{engine}': dm_control steps on the CPU."
            )
        from hts_walker.env import make_walker_env

        known = self.channels()
        wanted = {name: known[name] for name in (channels or known)}
        seeds = list(seeds) if seeds is not None else [config.seed + index for index in range(num_candidates)]
        return make_walker_env(num_candidates, num_envs, config.episode_seconds, wanted, seeds)
