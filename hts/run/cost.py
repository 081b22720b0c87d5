"""`--dry-run`: what a run will cost, before anything is spent."""

from __future__ import annotations

from typing import Any

from hts.config import RunConfig
from hts.contracts import WorldContext
from hts.plugins import Registry
from hts.ppo.sweep import candidates

# Control steps per second from collection to update, measured by `hts bench train` (two cores, one H200).
STEPS_PER_SECOND = {"mujoco": 4_500.0, "warp": 500_000.0}
BYTES_PER_SAMPLE = 4 * 600  # of a batch while it is learned from, all tensors
BASE_MEMORY_GB = 1.2  # torch, mujoco and the plugins, with the twin's processes


def estimate(config: RunConfig, registry: Registry) -> dict[str, Any]:
    """Numbers of a run that hold if nothing is refused; times are rough."""
    objectives = {name: registry.make_objective(name, settings) for name, settings in config.objectives.items()}
    robot = registry.make_robot(config.robot.name, config.robot.settings)
    proxy = config.reward_source == "proxy"
    weights = {
        name: config.sweep.weights.get(name) or (objective.baseline_weights if proxy else objective.weights)
        for name, objective in objectives.items()
    }
    counts = []
    for iteration in range(config.iterations):
        hashes = {anchor: anchor if iteration else "one" for anchor in config.sweep.anchors}
        counts.append(len(candidates(iteration, hashes, weights, config.sweep.kl_bounds)))
    context = WorldContext(config.robot.name, config.robot.settings, config.objectives, config.seed, folder=_nowhere())
    world = registry.make_world(config.world.name, config.world.settings, context)
    per_test = world.head_to_head_seconds() if hasattr(world, "head_to_head_seconds") else 320.0
    elites = sum(min(config.selection.elites, count) for count in counts)
    robot_seconds = 0.0 if proxy else config.collection.schedule.seconds * (config.collection.repeats + config.collection.exploring)
    robot_seconds += per_test * (elites + len(config.evaluation.speeds))
    steps = sum(counts) * config.finetune.steps
    test_steps = config.simulation_test.num_envs * len(config.simulation_test.speeds) * config.simulation_test.seconds * robot.spec.control_rate_hz
    steps += int((sum(counts) + config.iterations) * test_steps)
    together = min(max(counts), config.finetune.max_candidates)
    samples = together * config.finetune.num_envs * config.finetune.ppo.horizon
    cost = dict(world.cost(robot_seconds))
    world.close()
    return {
        "candidates": sum(counts), "tested on the robot": elites, "robot_minutes": robot_seconds / 60.0,
        "charges": robot_seconds / 60.0 / robot.spec.endurance_minutes if robot.spec.endurance_minutes else None,
        "simulation_steps": steps,
        "wall_minutes": (steps / STEPS_PER_SECOND.get(config.engine, 4_500.0) + cost.get("wall_seconds", robot_seconds)) / 60.0,
        "memory_gb": BASE_MEMORY_GB + samples * BYTES_PER_SAMPLE / 1e9,
    }  # fmt: skip


def _nowhere():
    """A folder name that is only made if a world insists on writing there."""
    import tempfile
    from pathlib import Path

    return Path(tempfile.gettempdir()) / "hts-dry-run"


def print_estimate(cost: dict[str, Any]) -> None:
    """One line each."""
    from rich.console import Console

    console = Console()
    labels = {
        "candidates": "candidates trained", "tested on the robot": "of them tested in the world", "robot_minutes": "minutes of walking",
        "charges": "charges of the robot", "simulation_steps": "simulation steps", "wall_minutes": "minutes in all, about", "memory_gb": "GB of memory, about",
    }  # fmt: skip
    for key, value in cost.items():
        if value is not None:
            shown = f"{value:,.1f}" if isinstance(value, float) else f"{value:,}"
            console.print(f"{labels[key]:>30}  {shown}", highlight=False)
