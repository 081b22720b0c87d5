"""A whole run of the smallest size: every stage of Algorithm 1 once, in seconds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from hts.api import Run, load, run
from hts.plugins import load as load_plugins

SETTINGS: dict[str, Any] = {
    "engine": "mujoco",
    "collection.schedule": {"commands": [{"seconds": 4.0, "vx": 0.5}, {"seconds": 4.0, "vx": 0.8}]},
    "collection.exploring": 1,
    "measurement.epochs": 1,
    "sweep.kl_bounds": [1.0],
    "finetune.num_envs": 2,
    "finetune.steps": 48,
    "finetune.ppo.epochs": 1,
    "simulation_test.num_envs": 2,
    "simulation_test.seconds": 3.0,
    "gate.num_envs": 2,
    "gate.seconds": 2.0,
    "selection.elites": 1,
    "evaluation.bootstrap": 100,
}
"""Laid over the preset `smoke`."""

TWIN = {"world.block_seconds": 3.0, "world.warmup_seconds": 1.0, "world.unsteady_seconds": 1.0}
"""The same for a run in the world `twin`."""


def tiny_run(
    out: Path,
    objective: str | Sequence[str] = "fake",
    robot: str = "tiny",
    *,
    world: str = "known",
    selector: str | None = None,
    settings: Mapping[str, Any] | None = None,
) -> Run:
    """Run into the new folder `out`; what it left behind. settings: dotted key -> value, laid over all others; None
    takes one of them away.

    Names are looked up among the installed plugins and the kit's own, so this needs `packages.kit_installed`.
    Raises what `hts run` prints as its one line.
    """
    names = [objective] if isinstance(objective, str) else list(objective)
    chosen: dict[str, Any] = {**SETTINGS, **(TWIN if world == "twin" else {})}
    if (task := load_plugins().make_robot(robot).task()).defaults:  # the robot's own, instead of speeds
        commands = [task.command(point, 4.0).model_dump() for point in task.defaults]
        chosen["collection.schedule"] = {"commands": commands}
    chosen |= {f"sweep.weights.{name}": [1.0] for name in names}
    if selector is not None:
        chosen["selection.selector.name"] = selector
    chosen |= dict(settings or {})
    chosen = {key: value for key, value in chosen.items() if value is not None}
    return load(run(names, robot, out=out, preset="smoke", world=world, settings=chosen))
