"""`hts bench sweep`: what training candidates together gains over training one after another."""

from __future__ import annotations

import statistics
import time
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import torch

from hts.bench.bare import synchronise
from hts.bench.collecting import WARM_UP
from hts.bench.setup import Sizes, conditions, find, make_trainer
from hts.ppo.trainer import PopulationTrainer

if TYPE_CHECKING:
    from hts.contracts import Objective, Robot

SWEEP = 6  # candidates
ALONE = {"cpu": (64, 128, 256, 512), "cuda": (2048, 4096, 8192, 16384, 32768)}
"""Numbers of worlds among which a candidate that trains alone has its fastest."""


def bench_sweep(
    robot: str | None, objective: str | None, engine: str = "mujoco", envs: int = 64, seconds: float = 10.0,
    candidates: int = SWEEP, sizes: Sizes | None = None, alone: Sequence[int] = (),
) -> dict[str, Any]:  # fmt: skip
    """Candidates trained together against one after another, at equal samples; all in control steps per second.

    speedup: over one after another with the same worlds each; the two alternate, a batch of all against a batch of one,
    so that one batch of one stands for each. speedup_over_fastest: over one after another with the number of worlds at
    which one alone is fastest, among `alone` (and `envs`). update_difference: see `same_results`.
    """
    machine, chosen = find(robot, objective)
    difference = same_results(machine, chosen, engine, candidates, envs, sizes)
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
    rate, same = steps / statistics.median(all_at_once), steps / statistics.median(one_by_one)
    rates = {envs: same}
    for worlds in alone or ALONE[device]:
        if worlds != envs:
            rates[worlds] = _rate_alone(machine, chosen, engine, worlds, sizes, seconds / 4)
    fastest = max(rates, key=lambda worlds: rates[worlds])
    return {
        "bench": "sweep", "steps_per_s": rate, "one_after_another_steps_per_s": same,
        "speedup": statistics.median(b / a for a, b in zip(all_at_once, one_by_one, strict=True)),
        "alone_steps_per_s": {str(worlds): rates[worlds] for worlds in sorted(rates)}, "fastest_alone_envs": fastest,
        "speedup_over_fastest": rate / rates[fastest], "update_difference": difference, "rounds": len(all_at_once),
        **about,
    }  # fmt: skip


def same_results(
    robot: Robot, objective: Objective, engine: str, candidates: int, envs: int, sizes: Sizes | None = None
) -> float:
    """How much a candidate's first batch changes its parameters differently in the crowd: |crowd - alone| / |alone - start|.

    Both start from the same parameters, seeds, worlds and measurement model; looked at in the first and the last
    candidate. 0 on the CPU; on a GPU single precision is summed in another order, and contact makes that grow.
    """
    crowd = make_trainer(robot, objective, engine, candidates, envs, sizes=sizes)
    model = next(part.model for part in _transforms(crowd))
    crowd.close()
    # Anew: taking the statistics has drawn random numbers and moved the robots.
    crowd = make_trainer(robot, objective, engine, candidates, envs, sizes=sizes, model=model)
    before = crowd.population.vectors[0].detach().clone()
    crowd.batch()
    after = [crowd.population.vectors[index].detach().clone() for index in (0, candidates - 1)]
    crowd.close()
    found = []
    for index, there in zip((0, candidates - 1), after, strict=True):
        single = make_trainer(robot, objective, engine, 1, envs, seed=index, sizes=sizes, model=model)
        single.batch()
        here = single.population.vectors[0].detach()
        found.append(float((there - here).norm() / (here - before).norm()))
        single.close()
    return max(found)


def _transforms(trainer: PopulationTrainer) -> list[Any]:
    transform = trainer.env.transform
    return list(transform) if hasattr(transform, "__iter__") else [transform]


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
