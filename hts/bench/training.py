"""`hts bench train|sweep`: whole batches of fine-tuning, and what training together gains."""

from __future__ import annotations

import statistics
import time
from typing import Any

from hts.bench.bare import synchronise
from hts.bench.collecting import WARM_UP, measure
from hts.bench.setup import conditions, find, make_trainer
from hts.ppo.trainer import PopulationTrainer

SWEEP = 6  # candidates


def bench_train(
    robot: str | None, objective: str | None, engine: str = "mujoco", candidates: int = 6, envs: int = 64,
    seconds: float = 20.0,
) -> dict[str, Any]:  # fmt: skip
    """Collect and update, with anchor and bound on, in control steps per second over all worlds, against bare physics
    of the same steps. Keys: steps_per_s, bare_steps_per_s, ratio, epochs, minibatches, …"""
    machine, chosen = find(robot, objective)
    trainer = make_trainer(machine, chosen, engine, candidates, envs)
    try:
        result = measure(trainer, trainer.batch, seconds)
        ppo = {"epochs": trainer.config.epochs, "minibatches": trainer.config.minibatches}
        return {"bench": "train", **result, **ppo, **conditions(trainer, machine, chosen, engine)}
    finally:
        trainer.close()


def bench_sweep(
    robot: str | None, objective: str | None, engine: str = "mujoco", envs: int = 64, seconds: float = 10.0
) -> dict[str, Any]:
    """Six candidates trained together against one after another, at equal samples; both in control steps per second.

    `speedup` is the first over the second. The two alternate, a batch of all against a batch of one, so that one batch
    of one stands for each of the six.
    """
    machine, chosen = find(robot, objective)
    together = make_trainer(machine, chosen, engine, SWEEP, envs)
    alone = make_trainer(machine, chosen, engine, 1, envs)
    try:
        for _ in range(WARM_UP):
            together.batch(), alone.batch()
        all_at_once: list[float]
        all_at_once, one_by_one, until = [], [], time.perf_counter() + seconds
        while len(all_at_once) < 3 or time.perf_counter() < until:
            all_at_once.append(_batch_seconds(together))
            one_by_one.append(SWEEP * _batch_seconds(alone))
        steps = together.steps_per_batch
        return {
            "bench": "sweep", "steps_per_s": steps / statistics.median(all_at_once),
            "one_after_another_steps_per_s": steps / statistics.median(one_by_one),
            "speedup": statistics.median(b / a for a, b in zip(all_at_once, one_by_one, strict=True)),
            "rounds": len(all_at_once), **conditions(together, machine, chosen, engine),
        }  # fmt: skip
    finally:
        together.close()
        alone.close()


def _batch_seconds(trainer: PopulationTrainer) -> float:
    synchronise(trainer.population.device)
    start = time.perf_counter()
    trainer.batch()
    synchronise(trainer.population.device)
    return time.perf_counter() - start
