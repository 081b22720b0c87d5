"""`--dry-run`: what a run will cost, before anything is spent."""

from __future__ import annotations

import math
import os
import tempfile
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from hts.config import RunConfig
from hts.errors import ConfigError
from hts.evaluation.held import ask_to_hold, hold_of
from hts.evaluation.simulation import trial_steps
from hts.guarded import guarded
from hts.parts import objectives_of, robot_of, world_of
from hts.plugins import Registry
from hts.report import wording
from hts.run.budget import candidate_counts, plan
from hts.run.robot_time import asked_of
from hts.training.sweep import weights_of

STEPS_PER_SECOND = {"mujoco": 4_500.0, "warp": 500_000.0}
"""Control steps per second from collection to update, where nobody measured them (`hts.run.speed` does on a CPU):
what `hts bench train` shows on two cores and on one H200."""

BYTES_PER_SAMPLE = 4 * 600
"""Of a batch while it is learned from: about 600 float32 numbers per control step (observations of actor and critic,
raw and normalised, channels, actions, and their gradients' working copies)."""

BASE_MEMORY_GB = 1.2
"""The libraries in the run's own process and in two processes of a twin, before anything is trained."""

AROUND_SECONDS = 20.0
"""What is neither simulated nor walked: processes that start, fits to a run's few minutes of logs, the report; of
`smoke` and of `quick`, on two cores."""

CONTAINER_LIMITS = (Path("/sys/fs/cgroup/memory.max"), Path("/sys/fs/cgroup/memory/memory.limit_in_bytes"))
"""Where Linux says how much memory a container may take, bytes: control groups of version 2 and 1."""


def estimate(config: RunConfig, registry: Registry, steps_per_second: float | None = None) -> dict[str, Any]:
    """Numbers of a run that hold if nothing is refused; times are rough. Those that end in `_most`: where all is done
    again that the settings allow.

    steps_per_second: control steps from collection to update as measured on this machine;
    None: those of STEPS_PER_SECOND.
    """
    rate = steps_per_second or STEPS_PER_SECOND.get(config.engine, STEPS_PER_SECOND["mujoco"])
    assumed = {"warp": "an H200", "mujoco": "two cores"}.get(config.engine, "two cores")
    objectives = objectives_of(config, registry)
    robot = robot_of(config, registry)
    weights = weights_of(objectives, config)
    nowhere = Path(tempfile.gettempdir()) / "hts-dry-run"  # a name only: worlds write with their first request
    world = world_of(config, registry, nowhere)
    hold = hold_of(config)
    ask_to_hold(world, hold)
    budget = plan(config, registry, world)
    counts = candidate_counts(config, registry)[: len(budget.elites)]
    asked = asked_of(config, registry, world, budget)
    least, most = asked.seconds
    walked, walked_most = (math.ceil(seconds * robot.spec.control_rate_hz) for seconds in asked.before)
    steps = sum(counts) * config.finetune.steps
    test = config.simulation_test
    test_steps = test.num_envs * len(test.speeds) * trial_steps(test, robot.spec.control_rate_hz)
    # Every candidate, as it is and as it was on the way, and the pretrained policy beside them.
    judged = sum(counts) * (1 + len(config.finetune.also_at))
    steps += round((judged + len(counts)) * test_steps)
    if config.gate.enabled:  # of the elites, of whom nobody is refused
        gate_steps = round(config.gate.seconds * robot.spec.control_rate_hz) * config.gate.num_envs * len(test.speeds)
        steps += sum(budget.elites) * gate_steps
    if hold is not None and test.hold_speed and (test.measured_pull or config.finetune.measured_pull):
        steps += round((len(counts) - 1) * test_steps)  # of the pretrained policy, once there are trials
    together = min(max(counts), config.finetune.max_candidates)
    samples = together * config.finetune.num_envs * config.finetune.ppo.horizon
    walls = [dict(world.cost(seconds)).get("wall_seconds", seconds) for seconds in (least, most)]
    beside = guarded(f"World '{config.world.name}': beside()", lambda: world.beside(asked.requests))
    world.close()
    endurance = robot.spec.endurance_minutes
    batch_gb = samples * BYTES_PER_SAMPLE / 1e9
    measured = "measured here" if steps_per_second else f"as on {assumed}; not measured here"
    return {
        "combinations": ", ".join(map(wording.weights, weights)) if len(objectives) > 1 else None,
        "selector": config.selection.selector.name,
        "candidates": sum(counts),
        "tested on the robot": sum(budget.elites),
        "iterations": len(budget.elites) if len(budget.elites) < config.iterations else None,
        "real_samples": walked if asked.raced else budget.samples,
        "real_samples_most": walked_most if asked.raced else max(budget.samples, walked_most),
        "robot_minutes": least / 60.0,
        "robot_minutes_most": most / 60.0,
        "charges": least / 60.0 / endurance if endurance else None,
        "charges_most": most / 60.0 / endurance if endurance else None,
        "beside": beside or None,
        "simulation_steps": steps,
        "speed": f"{rate:,.0f} a second, {measured}",
        "wall_minutes": (AROUND_SECONDS + steps / rate + walls[0]) / 60.0,
        "wall_minutes_most": (AROUND_SECONDS + steps / rate + walls[1]) / 60.0,
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


def _number(value: Any) -> str:
    return value if isinstance(value, str) else f"{value:,.1f}" if isinstance(value, float) else f"{value:,}"


def _from_to(least: str, most: str) -> str:
    """A range; one of them where both look the same."""
    return least if least == most else f"{least} to {most}"


def print_estimate(cost: dict[str, Any]) -> None:
    """One line each; last what a person has to do, where the world says it."""
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
            table.add_row(labels[key], _from_to(_number(value), _number(cost.get(f"{key}_most", value))))
    Console(highlight=False).print(table)
    if cost.get("beside"):
        Console(highlight=False).print(cost["beside"], soft_wrap=True, markup=False)


def print_ready(config: RunConfig) -> None:
    """What a dry run has built, and what it has not."""
    built = "Built once, all of it works: plugins and their settings, pretrained policy, rewards, world"
    rest = (
        ", env, a few batches of training."
        if config.engine == "mujoco"
        else "; the engine is there, its kernels were not compiled."
    )
    Console(highlight=False).print(built + rest, soft_wrap=True)
