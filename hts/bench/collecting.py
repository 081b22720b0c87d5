"""`hts bench env`: collection with policy, env and measurement model, against bare physics."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from typing import Any

from hts.bench.bare import Replay, engines_of, synchronise
from hts.bench.setup import Sizes, conditions, find, make_trainer
from hts.training.trainer import PopulationTrainer

WARM_UP, LEAST_ROUNDS = 3, 3  # batches


def bench_env(
    robot: str | None,
    objective: str | None,
    engine: str = "mujoco",
    candidates: int = 6,
    envs: int = 64,
    seconds: float = 10.0,
    sizes: Sizes | None = None,
) -> dict[str, Any]:
    """Collection by the collector, exploring policies, env and measurement model of a real run, in control steps per
    second over all env instances; `profile` is where the time of a step goes.
    Keys: steps_per_s, bare_steps_per_s, ratio, …"""
    machine, chosen = find(robot, objective)
    trainer = make_trainer(machine, chosen, engine, candidates, envs, sizes=sizes)
    try:
        result = measure(trainer, trainer.collect, seconds)
        return {"bench": "env", **result, "profile": profile(trainer), **conditions(trainer, machine, chosen)}
    finally:
        trainer.close()


def measure(trainer: PopulationTrainer, work: Callable[[], Any], seconds: float) -> dict[str, Any]:
    """Alternate `work`, which collects one batch (and may do more), with the bare replay of what it collected.

    On a GPU, where remembering would be part of what is timed, the batch that is replayed is the one after the timed
    one.
    """
    device, replay = trainer.population.device, Replay(engines_of(trainer.env))
    for _ in range(WARM_UP):
        work()
    fast: list[float]
    fast, bare, until = [], [], time.perf_counter() + seconds
    while len(fast) < LEAST_ROUNDS or time.perf_counter() < until:
        if device.type == "cpu":
            replay.start()
        synchronise(device)
        start = time.perf_counter()
        work()
        synchronise(device)
        fast.append(time.perf_counter() - start - replay.overhead)
        if device.type != "cpu":
            replay.start()
            trainer.collect()
        bare.append(replay.seconds())
    steps = trainer.steps_per_batch
    return {
        "steps_per_s": steps / statistics.median(fast),
        "bare_steps_per_s": steps / statistics.median(bare),
        "ratio": statistics.median(b / f for b, f in zip(bare, fast, strict=True)),
        "rounds": len(fast),
        "steps_per_round": steps,
    }


def profile(trainer: PopulationTrainer, batches: int = 3) -> dict[str, float] | None:
    """Shares of collection: physics, policy, measurement, env (reward, observation, resets), collector (the rest,
    waiting included); of the time of all threads, where groups of candidates have one each.

    None on a GPU, where the parts of a step are captured graphs and the time in Python says nothing.
    """
    if trainer.population.device.type != "cpu":
        return None
    groups = trainer.env.base_env.groups()
    parts = ("begin_step", "end_step", "rewards", "channel_values", "start_episodes")
    clocks = {
        "physics": [Clock(engine, "step") for engine in engines_of(trainer.env)],
        "policy": [Clock(trainer.population, "mean")],
        "measurement": [Clock(one, name) for one in trainer.env.transform for name in ("record", "forward_sequence")],
        "env": [Clock(group, name) for group in groups for name in parts],
    }
    start = time.perf_counter()
    for _ in range(batches):
        trainer.collect()
    total = (time.perf_counter() - start) * len(groups)
    spent = {name: sum(clock.stop() for clock in each) for name, each in clocks.items()}
    spent["collector"] = total - sum(spent.values())
    return {name: round(value / total, 4) for name, value in spent.items()}


class Clock:
    """Sums the time inside one method of one object. On a GPU that is launching, not computing."""

    def __init__(self, owner: Any, method: str) -> None:
        self.owner, self.method, self.seconds = owner, method, 0.0
        self._kept = getattr(owner, method)
        self._own = method in vars(owner)
        object.__setattr__(owner, method, self._timed)

    def _timed(self, *args: Any, **kwargs: Any) -> Any:
        start = time.perf_counter()
        try:
            return self._kept(*args, **kwargs)
        finally:
            self.seconds += time.perf_counter() - start

    def stop(self) -> float:
        """Put the method back; seconds so far."""
        if self._own:
            object.__setattr__(self.owner, self.method, self._kept)
        else:
            object.__delattr__(self.owner, self.method)
        return self.seconds
