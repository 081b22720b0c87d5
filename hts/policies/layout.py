"""What a policy observes: as its maker had it, and as our env has it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from pydantic import Field, ValidationError, field_validator, model_validator

from hts.config import Config, EnvConfig
from hts.contracts import Robot, RobotSpec
from hts.envs.observation import critic_observation_size, observation_layout
from hts.envs.velocity_robot import VelocityRobot
from hts.errors import ConfigError
from hts.explain import explain
from hts.policies.card_checks import LARGEST_OBSERVATION
from hts.policies.contract import GAINS, OF_JOINTS, Contract, check_keys, completed
from hts.rl.task_env import TaskEnv
from hts.yaml_text import load_mapping_file

if TYPE_CHECKING:
    from torchrl.envs import EnvBase


LONGEST_DELAY = 1.0  # s


@dataclass(frozen=True)
class Layout:
    """What a checkpoint without a card cannot say of itself.

    observation: parts in the checkpoint's order, [{name, size, scale}]; names as in our own observation or as mjlab,
    Isaac Lab, legged_gym and mujoco_playground call them; the network was given scale x value (1 if missing);
    `stand_in` (a part of ours, whose first numbers are taken) or `hold` (a number) in the place of what no robot
    measures. joint_names: the checkpoint's joint order; none: the robot's. contract: what else its maker states. rest:
    whether what is left out is the robot's own, what it observes too.
    """

    observation: tuple[Mapping[str, Any], ...]
    joint_names: tuple[str, ...] | None = None
    contract: Contract = field(default_factory=Contract)
    rest: bool = False


@dataclass(frozen=True)
class Seen:
    """What actor and critic see in the robot's env. parts: in order, [{name, size}]; critic: how many numbers."""

    parts: tuple[Mapping[str, Any], ...]
    critic: int


Numbers = float | list[float] | dict[str, float]


class _Part(Config):
    name: str = Field(description="as the robot's own observation calls it, or as the library does")
    size: int = Field(ge=1, le=LARGEST_OBSERVATION, description="numbers")
    scale: float | tuple[float, ...] = Field(1.0, description="the network was given scale x value; one, or one each")
    stand_in: str | None = Field(None, description="a part of ours that takes the place of what no robot measures")
    hold: float | None = Field(None, description="a constant that takes its place")

    @model_validator(mode="after")
    def _one_of_both(self) -> _Part:
        if self.stand_in is not None and self.hold is not None:
            raise ValueError("give stand_in or hold, not both")
        scales = self.scale if isinstance(self.scale, tuple) else (self.scale,) * self.size
        if len(scales) != self.size or not all(math.isfinite(one) and one != 0 for one in scales):
            raise ValueError(f"scale must be 1 or {self.size} finite numbers other than 0")
        return self


class LayoutFile(Config):
    """A layout as YAML."""

    observation: tuple[_Part, ...] | None = Field(
        None, min_length=1, description="parts in the order of the policy; left out: as the source says"
    )
    joint_names: tuple[str, ...] | None = Field(None, description="joints in the order of the policy")
    default_pose: Numbers | None = Field(None, description="joint angles where an action is zero, rad")
    action_scale: Numbers | None = Field(None, description="rad per action unit")
    kp: Numbers | None = Field(None, description="gains of the joint controllers it was trained with, N*m/rad")
    kd: Numbers | None = Field(None, description="gains of the joint controllers it was trained with, N*m*s/rad")
    control_rate_hz: float | None = Field(None, gt=0, le=1e5, description="how often the policy was asked, Hz")
    delay_seconds: float | tuple[float, float] | None = Field(
        None, description="from observation to the target's effect that it was trained with, s, or [least, most]"
    )
    action_clip: float | None = Field(None, gt=0, description="actions were kept within this, + and -")
    rest: Literal["robot"] | None = Field(None, description="robot: what is left out is the robot's own")

    @field_validator(*GAINS)
    @classmethod
    def _no_gain_pushes(cls, gains: Numbers | None) -> Numbers | None:
        """A negative gain drives a joint away from its target."""
        given = gains.values() if isinstance(gains, dict) else gains if isinstance(gains, list) else [gains]
        below = [one for one in given if one is not None and one < 0]
        if below:
            raise ValueError(f"{below[0]:g} is below 0, expected gains of 0 or more")
        return gains


def load_layout(file: Path, robot: RobotSpec | None = None) -> Layout:
    """The layout in a YAML file; robot: whose joints it names, and whose numbers `rest: robot` means. Raises
    ConfigError or PolicyError naming file and key."""
    try:
        found = LayoutFile.model_validate(load_mapping_file(file, "layout of a policy"))
    except ValidationError as error:
        raise ConfigError(f"{file}: {explain(error, LayoutFile)}") from error
    delay = found.delay_seconds
    least, most = delay if isinstance(delay, tuple) else (delay or 0.0, delay or 0.0)
    if not 0 <= least <= most <= LONGEST_DELAY:
        raise ConfigError(f"{file}: delay_seconds: {delay}, expected 0 to {LONGEST_DELAY:g} s, the least first.")
    keys = ("joint_names", *OF_JOINTS, "control_rate_hz", "action_clip")
    said = {key: getattr(found, key) for key in keys if getattr(found, key) is not None}
    if delay is not None:
        said["delay_seconds"] = (float(least), float(most))
    said_by = dict.fromkeys(said, file.name)
    contract = Contract(**said, said_by=said_by)
    if robot is not None:
        for key in OF_JOINTS:
            check_keys(file, key, said.get(key, 0.0), robot.joint_names)
    if found.rest == "robot" and robot is not None:
        for key in OF_JOINTS:
            if key in said and (whole := completed(file, key, said[key], robot)) != said[key]:
                said[key], said_by[key] = whole, f"{file.name} and the robot"
        contract = Contract(**said, said_by=said_by).of_robot(robot)
    parts = tuple(part.model_dump(exclude_none=True) for part in found.observation or ())
    return Layout(parts, found.joint_names, contract, found.rest == "robot")


def seen_in_velocity_task(robot: RobotSpec) -> Seen:
    """What is seen in the velocity task."""
    parts = observation_layout(robot.num_joints)
    return Seen(tuple(parts), critic_observation_size(robot.num_joints, len(robot.foot_sites)))


def seen_by(robot: Robot) -> Seen:
    """What is seen in the robot's own env, which is made once if it is not the velocity task.

    Raises ConfigError for a robot whose env does not say what a policy sees in it.
    """
    if isinstance(robot, VelocityRobot):
        return seen_in_velocity_task(robot.spec)
    env = robot.make_env("mujoco", 1, 1, EnvConfig(), seeds=[0])
    try:
        parts = layout_of(env, robot.spec.name)
        return Seen(tuple(parts), int(env.observation_spec["critic_observation"].shape[-1]))
    finally:
        env.close()


def layout_of(env: EnvBase, robot: str) -> list[dict[str, Any]]:
    """What a policy sees in an env, [{name, size}], for its card. robot: its name, for the message.

    Raises ConfigError for an env that does not derive from `hts.rl.TaskEnv`, or does and has no layout.
    """
    if not isinstance(env, TaskEnv):
        raise ConfigError(
            f"The env of robot '{robot}', a {type(env).__name__}, does not derive from hts.rl.TaskEnv, so what a "
            "policy sees in it is not asked for. Derive it from hts.rl.TaskEnv instead of EnvBase "
            "(hts.envs.folded.FoldedEnv is one already) and keep its observation_layout."
        )
    if env.observation_layout is None:
        raise ConfigError(
            f"The env of robot '{robot}', a {type(env).__name__}, does not say what a policy sees in it, which the "
            "policy's card must hold. Give it observation_layout = [{'name': …, 'size': …}, …]."
        )
    return env.observation_layout
