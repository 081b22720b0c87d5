"""What a policy observes: as its maker had it, as our env has it, and from one to the other."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import torch
from pydantic import Field, ValidationError

from hts.config import Config, EnvConfig
from hts.contracts import Robot, RobotSpec
from hts.envs.observation import critic_observation_size, observation_layout
from hts.envs.velocity_robot import VelocityRobot
from hts.errors import ConfigError, PolicyError, unknown_name
from hts.explain import explain
from hts.rl.task_env import TaskEnv
from hts.yaml_text import load_mapping_file

if TYPE_CHECKING:
    from torchrl.envs import EnvBase


@dataclass(frozen=True)
class Layout:
    """What a checkpoint without a card cannot say of itself.

    observation: parts in the checkpoint's order, [{name, size, scale}]; names as in our own observation; the network
    was given scale x value (1 if missing). joint_names: the checkpoint's joint order; none: the robot's.
    Default pose, action scale, gains and control rate must be the robot's, and the hidden layers' activation ELU.
    """

    observation: tuple[Mapping[str, Any], ...]
    joint_names: tuple[str, ...] | None = None


@dataclass(frozen=True)
class Seen:
    """What actor and critic see in the robot's env. parts: in order, [{name, size}]; critic: how many numbers."""

    parts: tuple[Mapping[str, Any], ...]
    critic: int


class _Part(Config):
    name: str = Field(description="as the robot's own observation calls it")
    size: int = Field(ge=1, description="numbers")
    scale: float = Field(1.0, gt=0, description="the network was given scale x value")


class LayoutFile(Config):
    """A layout as YAML."""

    observation: tuple[_Part, ...] = Field(min_length=1, description="parts in the order of the policy")
    joint_names: tuple[str, ...] | None = Field(None, description="joints in the order of the policy")


def load_layout(file: Path) -> Layout:
    """The layout in a YAML file. Raises ConfigError naming the file and the key."""
    try:
        found = LayoutFile.model_validate(load_mapping_file(file, "layout of a policy"))
    except ValidationError as error:
        raise ConfigError(f"{file}: {explain(error, LayoutFile)}") from error
    return Layout(tuple(part.model_dump() for part in found.observation), found.joint_names)


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


def order(
    path: Path, robot: RobotSpec, layout: Layout, ours: Sequence[Mapping[str, Any]]
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """For each of our observation entries the checkpoint's column and scale, and for each of our joints its index.

    Parts that begin with joint_ and `last_action` follow the joints. Raises PolicyError for other joints or parts.
    """
    names = layout.joint_names or robot.joint_names
    if sorted(names) != sorted(robot.joint_names):
        raise PolicyError(f"{path}: its joints {sorted(names)} are not those of robot '{robot.name}'.")
    joints = torch.tensor([names.index(name) for name in robot.joint_names])
    starts, start = {}, 0
    for part in layout.observation:
        starts[part["name"]] = (start, part)
        start += int(part["size"])
    known = {str(part["name"]) for part in ours}
    for name in starts:
        if name not in known:
            raise PolicyError(
                f"{path}: it observes what this task does not give. " + unknown_name("observation", name, known)
            )
    columns, scales = [], []
    for part in ours:
        name, size = str(part["name"]), int(part["size"])
        if name not in starts or int(starts[name][1]["size"]) != size:
            raise PolicyError(f"{path}: its layout has no part '{name}' of size {size}.")
        first, theirs = starts[name]
        of_joints = size == robot.num_joints and (name.startswith("joint_") or name == "last_action")
        columns.append(first + (joints if of_joints else torch.arange(size)))
        scales.append(torch.full((size,), float(theirs.get("scale", 1.0))))
    return torch.cat(columns), torch.cat(scales), joints
