"""What a robot's task means for a configuration: the set-points that presets cannot know, and which ones it takes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from hts.config import EnvConfig, RunConfig
from hts.contracts.speeds import fastest
from hts.contracts.task import FollowVelocity
from hts.errors import ConfigError, HtsError
from hts.guarded import guarded

if TYPE_CHECKING:
    from hts.contracts import Robot, RobotSpec, Task
    from hts.plugins import Registry


def task_layer(registry: Registry, robot: Any, preset: Mapping[str, Any]) -> dict[str, Any]:
    """What is laid over a preset for a robot whose task names its own set-points, or has none to command.

    robot: as it stands in the configuration; preset: its schedule says for how long. Where presets hold the
    speed, it does not: only a velocity can be held. Empty for a robot that follows commanded velocities, as presets do,
    and for one that cannot be made: that is said when names are checked.
    """
    if not isinstance(robot, Mapping) or not isinstance(robot.get("name"), str):
        return {}
    try:
        made = registry.make_robot(robot["name"], {key: value for key, value in robot.items() if key != "name"})
    except HtsError:
        return {}
    task = guarded(f"Robot '{robot['name']}': task()", made.task)
    equal_commands = {} if task.can_hold else {"hold_speed": False}
    points = list(task.defaults)
    if not points:
        return {"simulation_test": equal_commands, "evaluation": equal_commands} if equal_commands else {}
    seconds = sum(command["seconds"] for command in preset["collection"]["schedule"]["commands"]) / len(points)
    commands = [task.command(point, seconds).model_dump() for point in points]
    return {
        "collection": {"schedule": {"commands": commands}},
        "simulation_test": {"speeds": points, **equal_commands},
        "selection": {"speed": points[0], "speeds": []},
        "evaluation": {"speeds": points, **equal_commands},
    }


def check_simulated(robot: Robot) -> None:
    """There is something to train in. Raises ConfigError for a log-only robot."""
    from hts.contracts import Robot

    without_env = type(robot).make_env is Robot.make_env
    if without_env and robot.mjcf() is None and robot.pretrained_policy() is None:
        raise ConfigError(
            f"Robot '{robot.spec.name}' is log-only: it has no simulation; `hts import` and `hts fit` are for it. To "
            "train a policy it needs an env and a policy to start from (docs/authors/robot.md)."
        )


def check_task(config: RunConfig, robot: Robot) -> None:
    """Every set-point of the configuration is one of the robot's task, whose channels it gives. Raises ConfigError."""
    task: Task = robot.task()
    known = robot.channels()
    for name in task.channels:
        if name not in known and known:
            raise ConfigError(
                f"Robot '{robot.spec.name}': its task is judged by the channel '{name}', which it does not give "
                f"({', '.join(sorted(known))}). Add it to the robot's channels, or let Robot.task() name another task."
            )
    task.check(config.simulation_test.speeds, "simulation_test.speeds")
    if config.selection.speeds:
        task.check(config.selection.speeds, "selection.speeds")
    else:
        task.check((config.selection.speed,), "selection.speed")
    task.check(config.evaluation.speeds, "evaluation.speeds")
    task.check_tolerance(config.simulation_test.speed_tolerance, "simulation_test.speed_tolerance")
    task.check_tolerance(config.evaluation.speed_tolerance, "evaluation.speed_tolerance")
    task.check_schedule(config.collection.schedule, "collection.schedule")
    if config.evaluation.hold_speed:
        task.check_hold("evaluation.hold_speed")
    if config.simulation_test.hold_speed:
        task.check_hold("simulation_test.hold_speed")
    if isinstance(task, FollowVelocity):
        told: dict[str, Sequence[float]] = {
            "simulation_test.speeds": config.simulation_test.speeds,
            "selection.speeds" if config.selection.speeds else "selection.speed": config.selection.tested_speeds,
            "evaluation.speeds": config.evaluation.speeds,
        }
        _check_velocities({key: ("m/s", values) for key, values in told.items()}, robot.spec)
        for number, one in enumerate(config.collection.schedule.commands):
            place = f"collection.schedule.commands.{number}"
            both = {f"{place}.vx": ("m/s", [one.vx]), f"{place}.vy": ("m/s", [one.vy])}
            _check_velocities({**both, f"{place}.yaw_rate": ("rad/s", [one.yaw_rate])}, robot.spec)
        check_env_velocities(config.finetune.env, robot, "finetune.env")


def check_env_velocities(env: EnvConfig, robot: Robot, where: str) -> None:
    """Commands and pushes of a training env are such as a machine of this kind can follow. Raises ConfigError, which
    names the key, for others, which are in another unit. where: the key of the env. Only of the velocity task."""
    if not isinstance(robot.task(), FollowVelocity):
        return
    commands = env.commands
    told: dict[str, tuple[str, Sequence[float]]] = {
        f"{where}.commands.vx": ("m/s", commands.vx),
        f"{where}.commands.vy": ("m/s", commands.vy),
        f"{where}.commands.yaw_rate": ("rad/s", commands.yaw_rate),
        f"{where}.commands.fixed": ("m/s", commands.fixed),
        f"{where}.randomisation.push_speed": ("m/s", (env.randomisation.push_speed,)),
    }
    _check_velocities(told, robot.spec)


def check_speeds(speeds: Sequence[float], robot: Robot, where: str) -> None:
    """Speeds that are to be walked are such as a machine of this kind can follow. Raises ConfigError for others, which
    are in another unit. where: the key or the option that they stand under. Only of the velocity task."""
    if isinstance(robot.task(), FollowVelocity):
        _check_velocities({where: ("m/s", speeds)}, robot.spec)


OTHER_UNITS = {"m/s": "km/h or mm/s", "rad/s": "degrees/s"}


def _check_velocities(told: Mapping[str, tuple[str, Sequence[float]]], spec: RobotSpec) -> None:
    """told: key -> unit, and the numbers that stand under it."""
    most, whose = fastest(spec), " of a robot with feet" if spec.foot_sites else ""
    for key, (unit, values) in told.items():
        for found in values:
            if abs(found) > most:
                raise ConfigError(
                    f"{key}: expected at most {most:g} {unit}{whose}, found {found:g}. It is probably in "
                    f"another unit: write {unit}, not {OTHER_UNITS[unit]}."
                )
