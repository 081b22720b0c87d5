"""Robots: their numbers, their model, their channels, their policy, their env."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hts import units
from hts.channels import standard_channels
from hts.config import EnvConfig, RandomisationConfig
from hts.contracts import FollowVelocity, Robot, RobotSpec, Task
from hts.contracts.spec_faults import fault_of_height, fault_of_spec, fault_of_step, fault_of_times
from hts.envs.velocity_robot import VelocityRobot
from hts.errors import unknown_name
from hts.measurement.physics_steps import IN_STEPS
from hts.plugins import Entry, Registry
from hts.testing.checks.ensure import ensure, listed, same
from hts.testing.checks.robot_forces import CHECKS as ROBOT_FORCE_CHECKS
from hts.testing.checks.robot_models import CHECKS as COMPARISONS
from hts.testing.checks.robot_models import lacks_its_model, usable_model

ROBOT_MODEL_CHECKS = (*COMPARISONS, *ROBOT_FORCE_CHECKS)
STEPS, WORLDS, SEED = 12, 2, 11


def spec_is_consistent(entry: Entry, registry: Registry) -> None:
    """Made without settings; name as registered, every tuple of its spec follows the joints, poses within limits."""
    robot = entry.factory({})
    ensure(isinstance(robot, Robot), f"is a {type(robot).__name__}, not a hts.contracts.Robot")
    ensure("spec" in dir(robot), "its class sets no spec, a hts.contracts.RobotSpec")
    spec = robot.spec
    ensure(isinstance(spec, RobotSpec), f"its spec is a {type(spec).__name__}, not a hts.contracts.RobotSpec")
    ensure(spec.name == entry.name, f"its spec is called '{spec.name}'")
    ensure(len(set(spec.joint_names)) == spec.num_joints, f"joint names are {spec.joint_names}")
    fault = fault_of_spec(spec)
    ensure(not fault or fault in (fault_of_times(spec), fault_of_height(spec)), fault)  # those have their own checks
    for joint, pose, (low, high) in zip(spec.joint_names, spec.default_pose, spec.position_limit, strict=True):
        ensure(low < pose < high, f"default pose of '{joint}' is {pose} rad, outside its limits {low} to {high}")


def times_fit(entry: Entry, registry: Registry) -> None:
    """physics_dt · substeps is one control step, 1 / control_rate_hz."""
    fault = fault_of_times(entry.factory({}).spec)
    ensure(not fault, fault)


def channels_are_standard(entry: Entry, registry: Registry) -> None:
    """Its channels are named as they are listed, and a standard channel has its standard unit and size."""
    robot = entry.factory({})
    standard = standard_channels(robot.spec.num_joints, len(robot.spec.foot_sites))
    channels = robot.channels()
    ensure(
        isinstance(channels, Mapping),
        f"channels() gives a {type(channels).__name__}, expected names with hts.channels.Channel",
    )
    for name, channel in channels.items():
        ensure(channel.name == name, f"channel '{channel.name}' is listed as '{name}'")
        if name in standard:
            found, wanted = ((c.unit, c.shape) for c in (channel, standard[name]))
            ensure(
                found == wanted,
                f"channel '{name}' is {found[0]} {found[1]}, everybody else's is {wanted[0]} {wanted[1]}",
            )


def model_matches(entry: Entry, registry: Registry) -> None:
    """Its model compiles, is fresh each time, has the spec's names, and, if it follows a commanded velocity, a twin can
    be made of it. Only a log-only robot and one with an env of its own may have none."""
    robot = entry.factory({})
    root = robot.mjcf()
    ensure(
        not lacks_its_model(robot),
        "derives from VelocityRobot, whose env is made of its model, and mjcf() gives None, so there is nothing to "
        "train in. Return the model; a machine known by its logs alone derives from hts.contracts.LogOnlyRobot",
    )
    if root is None:
        return
    ensure(robot.mjcf() is not root, "mjcf() gives the same object twice: a change to one would change the other")
    from hts.sim.conventions import missing, without_free_trunk
    from hts.sim.models import compile_model
    from hts.worlds.twin.model import build
    from hts.worlds.twin.parameters import DynamicsParameters

    model, ordered = compile_model(robot), isinstance(robot, VelocityRobot)
    lacking = missing(model, robot.spec, ordered)
    ensure(not lacking, lacking)
    told = ordered and without_free_trunk(model, robot.spec)  # by `model_is_in_order`
    if isinstance(robot.task(), FollowVelocity) and not told:  # a twin knows no other task
        build(robot, DynamicsParameters())


def task_is_seen_in_channels(entry: Entry, registry: Registry) -> None:
    """Its task reads channels that it gives, says one number a sample and whether a second counts, and has a unit."""
    import torch

    robot = entry.factory({})
    task, known = robot.task(), robot.channels()
    ensure(isinstance(task, Task), f"task() gives a {type(task).__name__}, not a hts.contracts.Task")
    if type(task) is FollowVelocity:
        return
    ensure(units.known(task.unit), units.unknown(task.unit))
    ensure(bool(task.quantity.strip()), "its task does not say what is achieved: quantity is empty")
    for name in task.channels:
        ensure(name in known, "its task: " + unknown_name("channel", name, known))
    generator = torch.Generator().manual_seed(SEED)
    shape = (2, 3, STEPS)
    made_up = {name: torch.rand(*shape, *known[name].shape, generator=generator) for name in task.channels}
    achieved = torch.as_tensor(task.achieved(made_up))
    ensure(tuple(achieved.shape) == shape, f"achieved gives shape {tuple(achieved.shape)} for samples of shape {shape}")
    series = {name: value[0, 0].numpy() for name, value in made_up.items()}
    there = np.asarray(task.achieved(series))
    ensure(same(there, achieved[0, 0].numpy(), 1e-5), "achieved says something else of numpy's arrays than of torch's")
    for point in task.defaults or (0.8,):
        several = np.asarray(task.done(there, point, 0.1))
        ensure(several.shape == there.shape, f"done gives shape {several.shape} for {there.shape} means")
        one_by_one = [bool(task.done(float(mean), point, 0.1)) for mean in there]
        ensure(several.astype(bool).tolist() == one_by_one, "done says something else of a number than of an array")
        ensure(not bool(task.done(math.nan, point, 0.1)), "done takes a mean that is NaN for the task done")


def policy_fits(entry: Entry, registry: Registry) -> None:
    """Its pretrained policy, if it has one, is a .safetensors with a .json beside it, made for this very spec."""
    robot = entry.factory({})
    path = robot.pretrained_policy()
    if path is None:
        return
    ensure(
        isinstance(path, Path), f"pretrained_policy() gives a {type(path).__name__}, expected a pathlib.Path or None"
    )
    for file in (path, path.with_suffix(".json")):
        ensure(file.is_file(), f"{file} is not there")
    from hts.policies.files import load_policy

    load_policy(path, robot.spec)


def env_gives_what_was_asked(entry: Entry, registry: Registry) -> None:
    """Its env has batch size [P, N], the robot's control step, finite rewards [P, N, 1], the channels asked for, and
    leaves its config alone."""
    robot = entry.factory({})
    if not _has_env(entry, robot):
        return
    config, asked = _config(), tuple(sorted(robot.channels()))[:3]
    before = config.model_dump()
    env = _env(robot, 3, config, asked)
    ensure(config.model_dump() == before, "make_env changes the env's configuration in place")
    ensure(
        tuple(env.batch_size) == (3, WORLDS), f"its env has batch size {tuple(env.batch_size)} for P = 3, N = {WORLDS}"
    )
    ensure("dt" in dir(env), "its env has no attribute dt, the control step in s")
    fault = fault_of_step(env.dt, robot.spec)
    ensure(not fault, fault)
    (step, *_) = _steps(env)
    channels = {str(name): value for name, value in step["channels"].items()}
    ensure(set(channels) == set(asked), f"of channels {listed(asked)} its env writes {listed(channels)}")
    wanted = {name: (3, WORLDS, *robot.channels()[name].shape) for name in asked} | {"reward": (3, WORLDS, 1)}
    for name, value in {**channels, "reward": step["reward"]}.items():
        ensure(tuple(value.shape) == wanted[name], f"'{name}' has shape {tuple(value.shape)}, not {wanted[name]}")
        ensure(bool(value.isfinite().all()), f"'{name}' is not finite after one step")
    for name in ("observation", "critic_observation", "terminated", "truncated"):
        ensure(name in step.keys(), f"its env writes no '{name}'")  # noqa: SIM118 - a TensorDict
    env.close()


def env_keeps_the_physics_steps_it_promises(entry: Entry, registry: Registry) -> None:
    """If it says `keeps_physics_steps`, its env writes torque and speed of each physics step where they are asked for:
    [P, N, substeps, J], finite, and not one sample over and over."""
    robot = entry.factory({})
    if not robot.keeps_physics_steps or not _has_env(entry, robot):
        return
    asked = tuple(IN_STEPS.values())
    env = _env(robot, 3, _config(), asked)
    steps = _steps(env)
    env.close()
    written = [name for name in asked if ("channels", name) in steps[-1].keys(include_nested=True)]
    ensure(
        written == list(asked),
        f"keeps_physics_steps is set, and of channels {listed(asked)} its env writes {listed(written)}",
    )
    for name in asked:
        value = steps[-1]["channels", name]
        wanted = (3, WORLDS, robot.spec.substeps, robot.spec.num_joints)
        ensure(tuple(value.shape) == wanted, f"'{name}' has shape {tuple(value.shape)}, not {wanted}")
        ensure(bool(value.isfinite().all()), f"'{name}' is not finite")
        ensure(
            robot.spec.substeps == 1 or bool((value != value[:, :, :1]).any()),
            f"'{name}' is the same in each physics step of a control step",
        )


def env_does_not_depend_on_neighbours(entry: Entry, registry: Registry) -> None:
    """A candidate's walk is the same alone, in a crowd, and again: its random numbers come from its own seed."""
    robot = entry.factory({})
    if not _has_env(entry, robot):
        return
    asked = tuple(sorted(robot.channels()))
    env = _env(robot, 3, _config(), asked)
    crowd = _flat(_steps(env), 1)
    env.close()
    for what in ("is another one alone than in a crowd", "is another one the second time"):
        env = _env(robot, 1, _config(), asked, seeds=[SEED + 1])
        alone = _flat(_steps(env, only=1), 0)
        env.close()
        for name, values in crowd.items():
            ensure(same(values, alone[name], 1e-4), f"a candidate's '{name}' {what}")


def _has_env(entry: Entry, robot: Robot) -> bool:
    """Whether there is an env to try. Raises NotTried for one whose model the velocity task refuses, in one line, by
    then, or misses."""
    if isinstance(robot, VelocityRobot):
        return usable_model(entry) is not None or type(robot).make_env is not VelocityRobot.make_env
    return robot.mjcf() is not None or type(robot).make_env is not Robot.make_env


def _config() -> EnvConfig:
    """What any robot can be tried in: loads are in kg, and the default leaves nothing of a light trunk."""
    return EnvConfig(threads=1, randomisation=RandomisationConfig(models=2, added_mass=(0.0, 0.0)))


def _env(robot: Robot, count: int, config: EnvConfig, asked: Sequence[str], seeds: Sequence[int] | None = None) -> Any:
    own = list(seeds) if seeds is not None else [SEED + index for index in range(count)]
    return robot.make_env("mujoco", count, WORLDS, config, channels=tuple(asked), seeds=own)


def _steps(env: Any, only: int | None = None) -> list[Any]:
    """What STEPS control steps with small random actions give; only: those of this candidate of three."""
    import torch

    size = env.action_spec.shape[-1]
    actions = 0.3 * torch.randn(STEPS, 3, WORLDS, size, generator=torch.Generator().manual_seed(0))
    if only is not None:
        actions = actions[:, only : only + 1]
    state, found = env.reset(), []
    for action in actions[:, : env.batch_size[0]]:
        data, state = env.step_and_maybe_reset(state.set("action", action.to(env.device)))
        found.append(data["next"].clone())
    return found


def _flat(steps: list[Any], candidate: int) -> dict[str, Any]:
    """Name -> numbers of one candidate over all steps."""
    import torch

    found = {}
    for key in steps[0].keys(include_nested=True, leaves_only=True):
        values = torch.stack([step[key][candidate] for step in steps])
        found[key if isinstance(key, str) else "/".join(key)] = values.float().cpu().numpy()
    return found


CHECKS = (
    spec_is_consistent,
    times_fit,
    channels_are_standard,
    model_matches,
    *ROBOT_MODEL_CHECKS,
    task_is_seen_in_channels,
    policy_fits,
    env_gives_what_was_asked,
    env_keeps_the_physics_steps_it_promises,
    env_does_not_depend_on_neighbours,
)
