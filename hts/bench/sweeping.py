"""`hts bench sweep`: what training candidates together gains over training one after another."""

from __future__ import annotations

import statistics
import time
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import torch
from torchrl.envs.transforms import Compose

from hts.bench.bare import synchronise
from hts.bench.collecting import WARM_UP
from hts.bench.setup import Sizes, conditions, find, make_trainer
from hts.config import PPOConfig
from hts.training.trainer import PopulationTrainer

if TYPE_CHECKING:
    from hts.contracts import MeasurementModel, Objective, Robot

SWEEP = 6  # candidates
ALONE = {"cpu": (64, 128, 256, 512), "cuda": (2048, 4096, 8192, 16384, 32768)}
"""Numbers of env instances among which a candidate that trains alone has its fastest."""


def bench_sweep(
    robot: str | None,
    objective: str | None,
    engine: str = "mujoco",
    envs: int = 64,
    seconds: float = 10.0,
    candidates: int = SWEEP,
    sizes: Sizes | None = None,
    alone: Sequence[int] = (),
    whole: int = 0,
) -> dict[str, Any]:
    """Candidates trained together against one after another, at equal samples; all in control steps per second.

    speedup: over one after another with as many env instances each; the two alternate, a batch of all against a batch
    of one, so that one batch of one stands for each. speedup_over_fastest: over one after another with the number of
    instances at which one alone is fastest, among `alone` (and `envs`). update_difference, repeat_difference: see
    `same_results`.
    whole: also the keys of `whole_trainings`, each of so many control steps per candidate.
    """
    machine, chosen = find(robot, objective)
    same = same_results(machine, chosen, engine, candidates, envs, sizes)
    together = make_trainer(machine, chosen, engine, candidates, envs, sizes=sizes)
    one = make_trainer(machine, chosen, engine, 1, envs, sizes=sizes)
    try:
        for _ in range(WARM_UP):
            together.batch(), one.batch()
        all_at_once: list[float]
        all_at_once, one_by_one, until = [], [], time.perf_counter() + seconds
        while len(all_at_once) < 3 or time.perf_counter() < until:
            all_at_once.append(_batch_seconds(together))
            one_by_one.append(candidates * _batch_seconds(one))
        steps, about = together.steps_per_batch, conditions(together, machine, chosen)
        device = together.population.device.type
    finally:
        together.close()
        one.close()
    rate, in_turn = steps / statistics.median(all_at_once), steps / statistics.median(one_by_one)
    rates = {envs: in_turn}
    for worlds in alone or ALONE[device]:
        if worlds != envs:
            rates[worlds] = _rate_alone(machine, chosen, engine, worlds, sizes, seconds / 4)
    fastest = max(rates, key=lambda worlds: rates[worlds])
    spent = whole_trainings(machine, chosen, engine, candidates, envs, fastest, whole, sizes) if whole else {}
    return {
        "bench": "sweep",
        "steps_per_s": rate,
        "one_after_another_steps_per_s": in_turn,
        "speedup": statistics.median(b / a for a, b in zip(all_at_once, one_by_one, strict=True)),
        "alone_steps_per_s": {str(worlds): rates[worlds] for worlds in sorted(rates)},
        "fastest_alone_envs": fastest,
        "speedup_over_fastest": rate / rates[fastest],
        **same,
        "rounds": len(all_at_once),
        **spent,
        **about,
    }


def whole_trainings(
    robot: Robot,
    objective: Objective,
    engine: str,
    candidates: int,
    envs: int,
    envs_alone: int,
    steps: int,
    sizes: Sizes | None = None,
) -> dict[str, Any]:
    """Whole trainings of `steps` control steps per candidate, from nothing to the last batch: all together with `envs`
    worlds each, and one alone with `envs_alone`, whose time counts candidates times. Both have been run for a batch
    before, so that nothing is compiled for the first time. Keys: together_s, one_after_another_s, of each the part
    before the first batch is over (_first_batch_s), and how many batches one training had (_batches)."""
    model = _with_statistics(robot, objective, engine, envs, sizes)
    found: dict[str, Any] = {"whole_steps_per_candidate": steps}
    for name, count, worlds, times in (
        ("together", candidates, envs, 1),
        ("one_after_another", 1, envs_alone, candidates),
    ):
        for needed in (0, steps):
            start = time.perf_counter()
            trainer = make_trainer(robot, objective, engine, count, worlds, sizes=sizes, model=model)
            device = trainer.population.device
            try:
                trainer.batch()
                synchronise(device)
                first = time.perf_counter() - start
                while trainer.batches * trainer.steps_per_batch < needed * count:
                    trainer.batch()
                synchronise(device)
                batches = trainer.batches
            finally:
                trainer.close()
            total = time.perf_counter() - start
            del trainer  # its memory is free before the next one begins
            if device.type == "cuda":
                torch.cuda.empty_cache()
        found |= {f"{name}_s": times * total, f"{name}_first_batch_s": times * first, f"{name}_batches": batches}
    return {**found, "whole_speedup_over_fastest": found["one_after_another_s"] / found["together_s"]}


def same_results(
    robot: Robot, objective: Objective, engine: str, candidates: int, envs: int, sizes: Sizes | None = None
) -> dict[str, float]:
    """How much otherwise a candidate's first batch changes its parameters, with products in float32.

    update_difference: in the crowd, |crowd - alone| / |alone - start|, looked at in the first and the last candidate,
    which start from the same parameters, seeds, worlds and measurement model; repeat_difference: alone once more. 0 on
    the CPU. On a GPU sums are taken in another order, contact makes that grow, and Adam makes a whole step of the
    smallest gradient.
    """
    model = _with_statistics(robot, objective, engine, envs, sizes)

    def moved(count: int, seed: int) -> list[torch.Tensor]:
        """Parameters of all candidates after a batch, and of the first before it."""
        made = make_trainer(
            robot, objective, engine, count, envs, seed=seed, ppo=PPOConfig(tf32=False), sizes=sizes, model=model
        )
        try:
            start = made.population.vectors[0].detach().clone()
            made.batch()
            return [*(vector.detach().clone() for vector in made.population.vectors), start]
        finally:
            made.close()

    crowd, found = moved(candidates, 0), []
    for index in (0, candidates - 1):
        here, start = moved(1, index)
        found.append(float((crowd[index] - here).norm() / (here - start).norm()))
    again = moved(1, candidates - 1)[0]
    return {"update_difference": max(found), "repeat_difference": float((again - here).norm() / (here - start).norm())}


def _with_statistics(
    robot: Robot, objective: Objective, engine: str, envs: int, sizes: Sizes | None
) -> MeasurementModel:
    """A measurement model with its statistics. Taking them draws random numbers and moves robots, so none of the
    trainers that are compared does it."""
    trainer = make_trainer(robot, objective, engine, 1, envs, sizes=sizes)
    trainer.close()
    return next(part.model for part in _transforms(trainer))


def _transforms(trainer: PopulationTrainer) -> list[Any]:
    transform = trainer.env.transform
    return list(transform) if isinstance(transform, Compose) else [transform]


def _rate_alone(
    robot: Robot, objective: Objective, engine: str, envs: int, sizes: Sizes | None, seconds: float
) -> float:
    """Control steps per second of one candidate that trains alone."""
    trainer = make_trainer(robot, objective, engine, 1, envs, sizes=sizes)
    try:
        for _ in range(WARM_UP):
            trainer.batch()
        spent: list[float] = []
        while len(spent) < 3 or sum(spent) < seconds:
            spent.append(_batch_seconds(trainer))
        return trainer.steps_per_batch / statistics.median(spent)
    finally:
        trainer.close()
        if torch.cuda.is_available():
            torch.cuda.empty_cache()


def _batch_seconds(trainer: PopulationTrainer) -> float:
    synchronise(trainer.population.device)
    start = time.perf_counter()
    trainer.batch()
    synchronise(trainer.population.device)
    return time.perf_counter() - start
