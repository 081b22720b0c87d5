"""`hts bench train`: whole batches of fine-tuning."""

from __future__ import annotations

from typing import Any

from hts.bench.collecting import measure
from hts.bench.setup import Sizes, conditions, find, make_trainer


def bench_train(
    robot: str | None,
    objective: str | None,
    engine: str = "mujoco",
    candidates: int = 6,
    envs: int = 64,
    seconds: float = 20.0,
    sizes: Sizes | None = None,
) -> dict[str, Any]:
    """Collect and update, with anchor and bound on, in control steps per second over all env instances, against bare
    physics of the same steps. Keys: steps_per_s, bare_steps_per_s, ratio, epochs, minibatches, …"""
    machine, chosen = find(robot, objective)
    trainer = make_trainer(machine, chosen, engine, candidates, envs, sizes=sizes)
    try:
        result = measure(trainer, trainer.batch, seconds)
        ppo = {"epochs": trainer.config.epochs, "minibatches": trainer.config.minibatches}
        return {"bench": "train", **result, **ppo, **conditions(trainer, machine, chosen)}
    finally:
        trainer.close()
