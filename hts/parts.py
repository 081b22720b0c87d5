"""The parts of a run that its configuration names, made by their plugins: robot, objectives, models, world."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hts.config import Named, RunConfig
from hts.contracts import ModelContext, WorldContext, chosen_model, physics_steps_of, robot_signals
from hts.errors import PluginError

if TYPE_CHECKING:
    from hts.contracts import MeasurementModel, Objective, Robot, World
    from hts.plugins import Registry


def robot_of(config: RunConfig, registry: Registry) -> Robot:
    """The machine. Raises ConfigError."""
    return registry.make_robot(config.robot.name, config.robot.settings)


def objectives_of(config: RunConfig, registry: Registry) -> dict[str, Objective]:
    """By name, in the order of the configuration. Raises ConfigError."""
    return {name: registry.make_objective(name, settings) for name, settings in config.objectives.items()}


def world_of(
    config: RunConfig, registry: Registry, folder: Path, *, seed: int | None = None, command: str = ""
) -> World:
    """Where policies run "for real". seed: by default the run's; the rest as of `WorldContext`. Raises ConfigError."""
    context = WorldContext(
        robot=config.robot.name,
        robot_settings=config.robot.settings,
        objectives=config.objectives,
        seed=config.seed if seed is None else seed,
        folder=folder,
        registry=registry,
        command=command,
    )
    return registry.make_world(config.world.name, config.world.settings, context)


def make_model(registry: Registry, objective: Objective, settings: Mapping[str, Any], robot: Robot) -> MeasurementModel:
    """The measurement model of an objective for the robot's channels, not fitted yet. Raises ConfigError."""
    own = objective.measurement_model()
    if not isinstance(own, Named):
        raise PluginError(
            f"Objective '{objective.name}': measurement_model() gives {own!r}, expected hts.config.Named, such as "
            "Named(name='lstm')."
        )
    choice, signals = chosen_model(objective, settings), robot_signals(objective, robot)
    context = ModelContext(signals, own, physics_steps=physics_steps_of(robot))
    return registry.make_measurement_model(choice.name, choice.settings, context)
