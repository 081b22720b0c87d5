"""Fine-tuning of an iteration's candidates, all of them together."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import torch
from tensordict import TensorDict
from torchrl.envs import EnvBase
from torchrl.envs.transforms import Compose, Transform, TransformedEnv

from hts.config import FinetuneConfig
from hts.contracts import Robot
from hts.policies.files import Policy
from hts.rl.kl_bound import mean_kl, pull_inside
from hts.rl.population import Population
from hts.training.checkpoint import load_checkpoint, load_notes, save_checkpoint
from hts.training.sweep import Candidate
from hts.training.trainer import BatchStats, PopulationTrainer

CHECKPOINT_SECONDS = 60.0
KL_SLACK = 1.05  # of c, on a fresh batch; beyond it a candidate is pulled inside once more


@dataclass(frozen=True)
class Finetuned:
    """A candidate after training.

    tensors: as in a policy file; kl: mean KL(pi || anchor) over a fresh batch of its own states, nats;
    std: mean sigma, and that of the anchor, action units; stopped: why it was stopped early, or None.
    """

    candidate: Candidate
    tensors: Mapping[str, torch.Tensor]
    kl: float
    std: float
    anchor_std: float
    stopped: str | None = None
    history: list[dict[str, float]] = field(default_factory=list)


def measured_env(env: EnvBase, transforms: Sequence[Transform]) -> EnvBase:
    """The env with measurement models (or proxies) in it."""
    return TransformedEnv(env, Compose(*transforms), auto_unwrap=False) if transforms else env


def check_engine(env: EnvBase) -> None:
    """Raise SimulationError if a buffer of the env's physics overflowed; an env may have no engine of ours to ask."""
    engine = getattr(env, "engine", None)
    if engine is not None:
        engine.check()


def finetune(
    robot: Robot, engine: str, config: FinetuneConfig, candidates: Sequence[Candidate], anchors: Mapping[str, Policy],
    transforms: Callable[[], Sequence[Transform]], inputs: Sequence[str], *, seed: int, checkpoint: Path | None = None,
    key: str = "", progress: Callable[[float], None] | None = None, log: Callable[[BatchStats, Sequence[Candidate]], None] | None = None,
) -> tuple[list[Finetuned], int]:  # fmt: skip
    """Fine-tune candidates (in groups of `max_candidates`); returns them and the number of control steps.

    anchors: name -> policy; transforms: makes fresh measurement transforms for an env; inputs: channels they read;
    seed: every candidate draws from the same seed (common random numbers: they differ by λ, c and anchor alone);
    checkpoint: a file kept up to date while training and removed by the caller; key: what the checkpoint belongs to.
    """
    results: list[Finetuned] = []
    steps = 0
    groups = [candidates[i : i + config.max_candidates] for i in range(0, len(candidates), config.max_candidates)]
    for number, group in enumerate(groups):

        def share(part: float, number: int = number) -> None:
            if progress is not None:
                progress((number + part) / len(groups))

        place = checkpoint.with_name(f"{checkpoint.name}-{number}") if checkpoint is not None else None
        tuned, used = _finetune_group(
            robot, engine, config, group, anchors, transforms, inputs, seed, place, f"{key}/{number}", share, log
        )
        results += tuned
        steps += used
    return results, steps


def _finetune_group(
    robot, engine, config, group, anchors, transforms, inputs, seed, checkpoint, key, progress, log
) -> tuple[list[Finetuned], int]:  # fmt: skip
    count = len(group)
    starts = [anchors[candidate.anchor] for candidate in group]
    sizes = starts[0].card.sizes()
    env_config = config.env.model_copy(update={"seed": seed})
    bare = robot.make_env(engine, count, config.num_envs, env_config, channels=tuple(inputs), seeds=[seed] * count)
    env = measured_env(bare, transforms())
    population = Population.from_candidates(sizes, [start.tensors for start in starts], bare.device)
    bounds = torch.tensor([candidate.kl_bound for candidate in group])
    weights = {name: torch.tensor([candidate.weights[name] for candidate in group]) for name in group[0].weights}
    metadata = {"robot": robot.spec.name, "key": key, "worlds": count * config.num_envs}
    if not hasattr(bare, "full_state"):  # an env that cannot say where it is: if stopped, this stage starts again
        checkpoint = None
    resume = TensorDict(dict(load_checkpoint(checkpoint, metadata))) if checkpoint and checkpoint.exists() else None
    anchor = population.frozen()
    trainer = PopulationTrainer(
        env, population, config.ppo, seeds=[seed] * count, names=[candidate.id for candidate in group],
        anchor=anchor, bounds=bounds, weights=weights, resume=resume,
    )  # fmt: skip
    batches = max(1, round(config.steps * count / trainer.steps_per_batch))
    saved = time.monotonic()
    history: list[dict[str, Any]] = []
    if checkpoint is not None and resume is not None:  # what was before it, as if the process had never ended
        notes = load_notes(checkpoint)
        history = notes["history"]
        trainer.stopped.update({int(index): reason for index, reason in notes["stopped"].items()})
    while trainer.batches < batches:
        stats = trainer.batch()
        history.append({"steps": stats.steps // count, **stats.values})
        if log is not None:
            log(stats, group)
        progress(trainer.batches / batches)
        if checkpoint is not None and time.monotonic() - saved > CHECKPOINT_SECONDS and trainer.batches < batches:
            notes = {"history": history, "stopped": {str(index): why for index, why in trainer.stopped.items()}}
            save_checkpoint(checkpoint, trainer.full_state().to_dict(), metadata, notes)
            saved = time.monotonic()
    kl, extra = _settle(trainer, bounds.to(bare.device))
    check_engine(bare)
    std = population.log_std().exp().mean((1, 2)).tolist()
    anchor_std = anchor.log_std().exp().mean((1, 2)).tolist()
    tuned = [
        Finetuned(
            candidate, population.candidate(index), kl[index], std[index], anchor_std[index], trainer.stopped.get(index),
            [{name: (value[index] if isinstance(value, list) else value) for name, value in sorted(row.items())} for row in history],
        )
        for index, candidate in enumerate(group)
    ]  # fmt: skip
    steps = (trainer.batches + extra) * trainer.steps_per_batch
    trainer.close()
    return tuned, steps


def _settle(trainer: PopulationTrainer, bounds: torch.Tensor) -> tuple[list[float], int]:
    """Measure the KL on fresh batches of the finished candidates' own states; pull inside who ended beyond its bound."""
    population, anchor = trainer.population, trainer.anchor
    assert anchor is not None
    kl = torch.zeros_like(bounds)
    for attempt in range(1, 5):
        observation = trainer.collect()["observation"].flatten(1, 2)
        kl = mean_kl(population, anchor, observation)
        if bool((kl <= KL_SLACK * bounds).all()) or attempt == 4:
            break
        pull_inside(population, anchor, observation, bounds)
    return kl.tolist(), attempt
