"""`--dry-run`: what a run will cost, before anything is spent."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from hts.config import RunConfig
from hts.contracts import WorldContext
from hts.errors import ConfigError
from hts.evaluation.held import ask_to_hold, hold_of
from hts.evaluation.simulation import trial_seconds
from hts.plugins import Registry
from hts.run.budget import candidate_counts, plan, seconds_per_elite
from hts.training.sweep import combinations, own_weights

STEPS_PER_SECOND = {"mujoco": 4_500.0, "warp": 500_000.0}
"""Control steps per second from collection to update, where nobody measured them (`hts.run.speed` does on a CPU):
what `hts bench train` shows on two cores and on one H200."""

BYTES_PER_SAMPLE = 4 * 600
"""Of a batch while it is learned from: about 600 float32 numbers per control step (observations of actor and critic,
raw and normalised, channels, actions, and their gradients' working copies)."""

BASE_MEMORY_GB = 1.2
"""The libraries in the run's own process and in two processes of a twin, before anything is trained."""


CONTAINER_LIMITS = (Path("/sys/fs/cgroup/memory.max"), Path("/sys/fs/cgroup/memory/memory.limit_in_bytes"))
"""Where Linux says how much memory a container may take, bytes: control groups of version 2 and 1."""


def estimate(config: RunConfig, registry: Registry, steps_per_second: float | None = None) -> dict[str, Any]:
    """Numbers of a run that hold if nothing is refused; times are rough.

    steps_per_second: control steps from collection to update as measured on this machine;
    None: those of STEPS_PER_SECOND.
    """
    rate = steps_per_second or STEPS_PER_SECOND.get(config.engine, STEPS_PER_SECOND["mujoco"])
    assumed = {"warp": "an H200", "mujoco": "two cores"}.get(config.engine, "two cores")
    objectives = {name: registry.make_objective(name, settings) for name, settings in config.objectives.items()}
    robot = registry.make_robot(config.robot.name, config.robot.settings)
    proxy = config.reward_source == "proxy"
    weights = combinations(own_weights(objectives, proxy), config.sweep.weights)
    nowhere = Path(tempfile.gettempdir()) / "hts-dry-run"  # a name only: worlds write with their first request
    context = WorldContext(
        config.robot.name, config.robot.settings, config.objectives, config.seed, folder=nowhere, registry=registry
    )
    world = registry.make_world(config.world.name, config.world.settings, context)
    hold = hold_of(config)
    ask_to_hold(world, hold)
    budget = plan(config, registry, world)
    counts = candidate_counts(config, registry)[: len(budget.elites)]
    per_elite = seconds_per_elite(config, world)
    per_final = world.head_to_head_seconds()
    if hold is not None:  # the final is held, and done at equal commands beside
        ask_to_hold(world, None)
        per_final += world.head_to_head_seconds()
    elites = sum(budget.elites)
    tests = elites + budget.confirm
    collected = config.collection.repeats + config.collection.exploring
    robot_seconds = budget.schedule.seconds * collected if config.records_first else 0.0
    robot_seconds += per_elite * tests + per_final * len(config.evaluation.speeds) * config.evaluation.sessions
    steps = sum(counts) * config.finetune.steps
    test = config.simulation_test
    test_steps = test.num_envs * len(test.speeds) * trial_seconds(test) * robot.spec.control_rate_hz
    # Every candidate, as it is and as it was on the way, and the pretrained policy beside them.
    judged = sum(counts) * (1 + len(config.finetune.also_at))
    steps += round((judged + len(counts)) * test_steps)
    together = min(max(counts), config.finetune.max_candidates)
    samples = together * config.finetune.num_envs * config.finetune.ppo.horizon
    cost = dict(world.cost(robot_seconds))
    # Trials of an iteration's elites are one request, or one a round; of a final at held speed there are two.
    comparisons = len(budget.elites) + (budget.confirm > 1) + (1 if hold is None else 2)
    recorded = config.records_first and collected > 0
    beside = world.beside(comparisons + recorded, comparisons)
    world.close()
    batch_gb = samples * BYTES_PER_SAMPLE / 1e9
    measured = "measured here" if steps_per_second else f"as on {assumed}; not measured here"
    return {
        "combinations": ", ".join(_shown(one) for one in weights) if len(objectives) > 1 else None,
        "selector": config.selection.selector.name,
        "candidates": sum(counts),
        "tested on the robot": elites,
        "iterations": len(budget.elites) if len(budget.elites) < config.iterations else None,
        "real_samples": budget.samples,
        "robot_minutes": robot_seconds / 60.0,
        "charges": robot_seconds / 60.0 / robot.spec.endurance_minutes if robot.spec.endurance_minutes else None,
        "beside": beside or None,
        "simulation_steps": steps,
        "speed": f"{rate:,.0f} a second, {measured}",
        "wall_minutes": (steps / rate + cost.get("wall_seconds", robot_seconds)) / 60.0,
        "memory_gb": BASE_MEMORY_GB + batch_gb,
        "host_memory_gb": BASE_MEMORY_GB + (0.0 if _on_gpu(config) else batch_gb),
    }


def _on_gpu(config: RunConfig) -> bool:
    """Whether batches lie in a GPU's memory, of which nothing is known here."""
    return config.finetune.env.device.startswith("cuda") or (
        config.engine == "warp" and config.finetune.env.device == "auto"
    )


def check_memory(cost: Mapping[str, Any]) -> None:
    """Raise ConfigError for a run that needs more memory than this machine has. cost: of `estimate`."""
    there = machine_memory_gb()
    needed = cost["host_memory_gb"]
    if there is not None and needed > there:
        raise ConfigError(
            f"This run needs about {needed:,.0f} GB of memory, this machine has {there:,.1f}. Train with fewer env "
            "instances (--set finetune.num_envs=N), or fewer candidates together (--set finetune.max_candidates=P)."
        )


def machine_memory_gb() -> float | None:
    """Of the whole machine, or of the container where that is less, GB; None where nobody says."""
    try:
        found = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, OSError, ValueError):
        return None
    for limit in CONTAINER_LIMITS:
        with suppress(OSError, ValueError):  # not there, or the word `max`
            found = min(found, int(limit.read_text(encoding="ascii")))
    return found / 1e9 if found > 0 else None


def _shown(weights: Mapping[str, float]) -> str:
    """λ of one candidate, those that are not 0: "1 calm + 5 quiet"."""
    return " + ".join(f"{value:g} {name}" for name, value in weights.items() if value)


def print_estimate(cost: dict[str, Any]) -> None:
    """One line each; last what a person has to do, where the world says it."""
    from rich.console import Console
    from rich.table import Table

    table = Table.grid(padding=(0, 2))
    table.add_column(justify="right", width=30)
    table.add_column()
    labels = {
        "combinations": "combinations of λ",
        "selector": "selector",
        "candidates": "candidates trained",
        "tested on the robot": "of them tested in the world",
        "iterations": "iterations that the cap leaves",
        "real_samples": "real samples before the final",
        "robot_minutes": "minutes of walking",
        "charges": "charges of the robot",
        "simulation_steps": "simulation steps",
        "speed": "of them",
        "wall_minutes": "minutes in all, about",
        "memory_gb": "GB of memory, about",
    }
    for key, value in cost.items():
        if value is not None and key in labels:
            shown = value if isinstance(value, str) else f"{value:,.1f}" if isinstance(value, float) else f"{value:,}"
            table.add_row(labels[key], shown)
    Console(highlight=False).print(table)
    if cost.get("beside"):
        Console(highlight=False).print(cost["beside"], soft_wrap=True, markup=False)


def print_ready(config: RunConfig) -> None:
    """What a dry run has built, and what it has not."""
    from rich.console import Console

    built = "Built once, all of it works: plugins and their settings, pretrained policy, rewards, world"
    rest = (
        ", env, a few batches of training."
        if config.engine == "mujoco"
        else "; the engine is there, its kernels were not compiled."
    )
    Console(highlight=False).print(built + rest, soft_wrap=True)
