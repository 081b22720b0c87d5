"""A robot: a machine's model, numbers, channels and first policy."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from hts.contracts.task import VELOCITY, Task
from hts.errors import ConfigError

if TYPE_CHECKING:
    from torchrl.envs import EnvBase

    from hts.channels import Channel
    from hts.config import EnvConfig


@dataclass(frozen=True)
class JointMotors:
    """Motor constants per joint, each a tuple of length J in joint order. Sources belong in the robot's module.

    torque_constant: N·m at the joint per q-axis peak ampere; gear_ratio: rotor turns per joint turn;
    phase_resistance_ohm: per phase at 25 °C.
    """

    torque_constant: tuple[float, ...]
    gear_ratio: tuple[float, ...]
    phase_resistance_ohm: tuple[float, ...]


@dataclass(frozen=True)
class RobotSpec:
    """Everything a controller must know of a machine. Tuples of length J follow `joint_names`.

    name: as registered; joint_names: in the robot's own order, J of them; default_pose rad; kp N·m/rad; kd N·m·s/rad;
    action_scale rad per action unit (joint target = default_pose + action_scale · action); torque_limit N·m;
    velocity_limit rad/s; position_limit (low, high) rad; control_rate_hz: policy rate; physics_dt: step of the training
    simulation, s; substeps: of them per control step, physics_dt · substeps = 1 / control_rate_hz; base_height m: of
    the trunk in the default pose. trunk_body, foot_sites: names in the MJCF, of a body and of F sites; motors: motor
    constants, for who reads them.
    """

    name: str
    joint_names: tuple[str, ...]
    default_pose: tuple[float, ...]
    kp: tuple[float, ...]
    kd: tuple[float, ...]
    action_scale: tuple[float, ...]
    torque_limit: tuple[float, ...]
    velocity_limit: tuple[float, ...]
    position_limit: tuple[tuple[float, float], ...]
    control_rate_hz: float
    physics_dt: float
    substeps: int
    base_height: float
    trunk_body: str = "trunk"
    foot_sites: tuple[str, ...] = ()
    endurance_minutes: float | None = None  # of walking on one charge, for the estimate of `--dry-run`
    motors: JointMotors | None = None

    @property
    def num_joints(self) -> int:
        return len(self.joint_names)

    @classmethod
    def log_only(
        cls,
        name: str,
        joint_names: Sequence[str],
        *,
        torque_limit: Sequence[float],
        velocity_limit: Sequence[float],
        position_limit: Sequence[tuple[float, float]],
        rate_hz: float,
        kp: Sequence[float] | None = None,
        kd: Sequence[float] | None = None,
    ) -> RobotSpec:
        """What is known of a machine that is known by its logs: joints, limits (N·m, rad/s, rad) and rate, Hz.

        kp N·m/rad, kd N·m·s/rad: of its joint controllers; None, not known, is kept as 0. What only a simulation asks
        for is filled in: the default pose is the middle of the range, an action unit is 1 rad.
        """
        count = len(joint_names)
        return cls(
            name=name,
            joint_names=tuple(joint_names),
            default_pose=tuple((low + high) / 2 for low, high in position_limit),
            kp=tuple(kp) if kp is not None else (0.0,) * count,
            kd=tuple(kd) if kd is not None else (0.0,) * count,
            action_scale=(1.0,) * count,
            torque_limit=tuple(torque_limit),
            velocity_limit=tuple(velocity_limit),
            position_limit=tuple((low, high) for low, high in position_limit),
            control_rate_hz=rate_hz,
            physics_dt=1.0 / rate_hz,
            substeps=1,
            base_height=0.0,
        )


class Robot(ABC):
    """A machine: its model, its numbers, its channels, its first policy.

    A log-only robot has a spec and channels but neither model nor policy: `mjcf` and
    `pretrained_policy` return None; that is enough for import and fit. To train in, a robot needs an env: one that
    follows commanded velocities derives from `hts.envs.velocity_robot.VelocityRobot` instead, any other brings its own
    `make_env`, and may then do without a model: only the velocity task, the twin and `hts play` ask for one.
    """

    spec: RobotSpec
    keeps_physics_steps: bool = False
    """Whether `make_env`, asked for them, writes the channels of `hts.channels.substep_channels` too: what the physics
    steps of each control step were like. By default it does not."""

    held_at_zero: Mapping[str, float] = MappingProxyType({})
    """Sim channels, each of a single number, that fine-tuning holds at zero on average (`finetune.hold`): how well the
    task is done, so that less of it is no saving. By default there is none.

    The value is an error that matters, above 0, in the channel's unit: a mean that far from zero is answered at once
    (`hts.rl.EqualityMultiplier`). Samples of exactly 0 say nothing (the robot stands, or was only just told another
    speed) and are in no mean. The velocity task holds `speed_error`, a share of the command, with 0.02: 2 % of the
    speed, and its trend over commands. `make_env` is asked for such a channel like for any other; recordings need not
    have it."""

    held_below: Mapping[str, float] = MappingProxyType({})
    """Sim channels, each of a single number, whose mean fine-tuning keeps at or below a number above 0, in the
    channel's unit (`finetune.hold_below`, where `finetune.hold` is on): how far the task is missed, samples of exactly
    0 in no mean here either. The velocity task keeps `speed_missed_slow` below 0.08 and `speed_missed_fast` below 0.04.
    By default there is none."""

    bundle_commands: Sequence[str] = ()
    """What a person types on the robot's computer, in the folder of a deploy bundle, to check it and to do its rows:
    one command each, in that order, for the bundle's README. What they start warms the robot up, swaps the policies,
    keeps the heading of rows that ask for no turn, holds speeds where the manifest says so, and, typed again, goes on
    with the rows that have no log. By default there is none: the package brings no runtime, and the README says what a
    runner of one's own has to do."""

    @abstractmethod
    def mjcf(self) -> Any | None:
        """A fresh `dm_control.mjcf.RootElement` with floor, actuators and sensors; None if log-only."""

    @abstractmethod
    def channels(self) -> Mapping[str, Channel]:
        """Sim channels that this robot gives, by name."""

    @abstractmethod
    def pretrained_policy(self) -> Path | None:
        """Path of the starting policy's `.safetensors` (its `.json` lies beside it); None if log-only."""

    def task(self) -> Task:
        """What it is asked to do, and what counts as doing it. By default to follow a commanded velocity; a robot with
        an env of its own may have another."""
        return VELOCITY

    def make_env(
        self,
        engine: str,
        num_candidates: int,
        num_envs: int,
        config: EnvConfig,
        channels: Sequence[str] = (),
        seeds: Sequence[int] | None = None,
    ) -> EnvBase:
        """A TorchRL env of batch size [num_candidates, num_envs] that writes ("channels", name).

        channels: names to write, all if empty; seeds: one per candidate, so that a candidate's random numbers
        do not depend on its neighbours. config.commands.fixed: the set-points at which candidates are judged, env
        instance n at fixed[n mod len]; empty in training. `hts.envs.folded` helps to bring an env of another library.
        The env has `dt`,
        s per control step, and may have `observation_layout` (for the card of a policy that is pretrained in it),
        `full_state` and `load_full_state` (to go on from a checkpoint), and `engine`.

        By default a robot has none: raises ConfigError, which says how to give it one.
        """
        raise ConfigError(
            f"Robot '{self.spec.name}' has no env to train in. If it follows commanded velocities, let its class "
            "derive from hts.envs.velocity_robot.VelocityRobot instead of hts.contracts.Robot (whose default env that "
            "was in version 1 of the hooks); else give it a make_env. A log-only robot is for `hts import` and `hts "
            "fit`."
        )


class LogOnlyRobot(Robot):
    """A machine known by its logs alone: enough for `hts import` and `hts fit`.

    spec: see `RobotSpec.log_only`; channels: the sim channels that its logs hold, those that a model will read.
    """

    def __init__(self, spec: RobotSpec, channels: Iterable[Channel]) -> None:
        self.spec = spec
        self._channels = {channel.name: channel for channel in channels}

    def mjcf(self) -> None:
        """It has no model."""
        return

    def channels(self) -> Mapping[str, Channel]:
        return dict(self._channels)

    def pretrained_policy(self) -> None:
        """It has no policy."""
        return
