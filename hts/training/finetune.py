"""Fine-tuning of an iteration's candidates, all of them together."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Protocol

import torch
from tensordict import TensorDict
from torchrl.envs import EnvBase
from torchrl.envs.transforms import Compose, Transform, TransformedEnv

from hts.config import FinetuneConfig
from hts.config_base import percent
from hts.contracts import Robot
from hts.policies.files import Policy
from hts.rl.kl_bound import mean_kl, project_to_kl_bound
from hts.rl.population import Population
from hts.rl.task_env import TaskEnv
from hts.training.averaged import Averaged
from hts.training.checkpoint import load_checkpoint, load_notes, save_checkpoint
from hts.training.halfway import Halfway, Moment
from hts.training.held import Held, Holding, begun_at, found_prices
from hts.training.sweep import Candidate
from hts.training.trainer import BatchStats, PopulationTrainer

CHECKPOINT_SECONDS = 60.0
KL_SLACK = 1.05  # of c, on a fresh batch; beyond it a candidate is projected back
MOST_PROJECTIONS = 8


@dataclass(frozen=True)
class Finetuned:
    """A candidate after training.

    tensors: as in a policy file; kl: mean KL(pi || anchor) over a fresh batch of its own states, nats;
    std: mean sigma, and that of the anchor, action units; stopped: why it was stopped early, or None; share: how much
    of its training it has behind it, 1 but for those that were kept on the way; prices: of what was held, per strength
    of the rewards (see `found_prices`).
    """

    candidate: Candidate
    tensors: Mapping[str, torch.Tensor]
    kl: float
    std: float
    anchor_std: float
    stopped: str | None = None
    history: list[dict[str, float]] = field(default_factory=list)
    share: float = 1.0
    prices: Mapping[str, float] = field(default_factory=dict)


def measured_env(env: EnvBase, transforms: Sequence[Transform]) -> EnvBase:
    """The env with measurement models (or proxies) in it."""
    return TransformedEnv(env, Compose(*transforms), auto_unwrap=False) if transforms else env


def check_env(env: EnvBase) -> None:
    """Raise SimulationError if something went wrong in the simulator since the start; an env of another kind than
    `TaskEnv` cannot be asked."""
    if isinstance(env, TaskEnv):
        env.check()


Log = Callable[[BatchStats, Sequence[Candidate]], None]
Share = Callable[[float], None]


def finetune(
    robot: Robot,
    engine: str,
    config: FinetuneConfig,
    candidates: Sequence[Candidate],
    anchors: Mapping[str, Policy],
    transforms: Callable[[], Sequence[Transform]],
    inputs: Sequence[str],
    *,
    seed: int,
    checkpoint: Path | None = None,
    key: str = "",
    progress: Share | None = None,
    log: Log | None = None,
) -> tuple[list[Finetuned], int]:
    """Fine-tune candidates (in groups of `max_candidates`); returns them and the number of control steps.

    anchors: name -> policy; transforms: makes fresh measurement transforms for an env; inputs: channels they read;
    seed: every candidate draws from the same seed (common random numbers: they differ by λ, c and anchor alone);
    checkpoint: a file kept up to date while training and removed by the caller; key: what the checkpoint belongs to.
    """
    results: list[Finetuned] = []
    steps = 0
    groups = [candidates[i : i + config.max_candidates] for i in range(0, len(candidates), config.max_candidates)]
    for number, members in enumerate(groups):

        def share(part: float, number: int = number) -> None:
            if progress is not None:
                progress((number + part) / len(groups))

        env_config = config.env.model_copy(update={"seed": seed})
        held = Holding.of(robot, config)
        channels = tuple(dict.fromkeys((*inputs, *held.names)))
        bare = robot.make_env(
            engine, len(members), config.num_envs, env_config, channels=channels, seeds=[seed] * len(members)
        )
        place = checkpoint.with_name(f"{checkpoint.name}-{number}") if checkpoint is not None else None
        saved = Saved(place, {"robot": robot.spec.name, "key": f"{key}/{number}", "worlds": bare.batch_size.numel()})
        around = [*transforms(), *([Held(held.names)] if held.names else [])]
        starts = [anchors[member.anchor] for member in members]
        try:
            group = Group(members, starts, bare, around, config, seed, saved, held)
        except BaseException:
            bare.close()
            raise
        try:
            group.train(share, log)
            results += group.finished()
            steps += group.steps
        finally:
            group.trainer.close()
    return results, steps


class Kept(Protocol):
    """Something that is kept on the way, beside the trainer's own state."""

    def state(self) -> Mapping[str, Any]:
        """Tensors."""
        ...

    def notes(self) -> Any:
        """JSON values."""
        ...


class Saved:
    """The checkpoint of one training. path: None for none; metadata: what it belongs to."""

    def __init__(self, path: Path | None, metadata: Mapping[str, Any]) -> None:
        self.path, self.metadata = path, metadata
        self._when = time.monotonic()

    def load(self) -> tuple[TensorDict, dict[str, Any]] | None:
        """State and notes, if there are any."""
        if self.path is None or not self.path.exists():
            return None
        return TensorDict(dict(load_checkpoint(self.path, self.metadata))), load_notes(self.path)

    def keep(self, trainer: PopulationTrainer, history: Sequence[Mapping[str, Any]], kept: Mapping[str, Kept]) -> None:
        """Save, if it is time to, and if the env can be saved; if not, a stopped fine-tuning starts again."""
        if self.path is None or time.monotonic() - self._when <= CHECKPOINT_SECONDS or not trainer.resumable:
            return
        stopped = {str(index): why for index, why in trainer.stopped.items()}
        notes = {"history": history, "stopped": stopped, **{name: one.notes() for name, one in kept.items()}}
        states = {name: one.state() for name, one in kept.items()}
        state = trainer.full_state().to_dict() | {name: state for name, state in states.items() if state}
        save_checkpoint(self.path, state, self.metadata, notes)
        self._when = time.monotonic()


class Group:
    """Candidates that are trained together.

    starts: the anchor of each; bare: an env for them, without measurement; held: channels whose mean is held, which
    `transforms` write; the rest as in `finetune`.
    """

    def __init__(
        self,
        members: Sequence[Candidate],
        starts: Sequence[Policy],
        bare: EnvBase,
        transforms: Sequence[Transform],
        config: FinetuneConfig,
        seed: int,
        saved: Saved,
        held: Holding,
    ) -> None:
        count = len(members)
        self.members, self.bare, self.saved = members, bare, saved
        self.population = Population.from_candidates(
            starts[0].card.sizes(), [start.tensors for start in starts], bare.device
        )
        self.anchor = self.population.frozen()
        self.bounds = torch.tensor([member.kl_bound for member in members])
        self.history: list[dict[str, Any]] = []
        before = saved.load()
        self.trainer = PopulationTrainer(
            measured_env(bare, transforms),
            self.population,
            config.ppo,
            seeds=[seed] * count,
            names=[member.id for member in members],
            anchor=self.anchor,
            bounds=self.bounds,
            weights={name: torch.tensor([member.weights[name] for member in members]) for name in members[0].weights},
            held=held.at_zero,
            held_below=held.below,
            prices=begun_at([start.card.made for start in starts], held) if config.hold_from_anchor else None,
            resume=before[0] if before is not None else None,
        )
        self.batches = max(1, round(config.steps * count / self.trainer.steps_per_batch))
        self._extra = 0
        self.halfway = Halfway(config.also_at, self.batches)
        self.averaged = Averaged(config.average, self.batches)
        self.held = held
        if before is not None:  # what was before it, as if the process had never ended
            self.history = before[1]["history"]
            self.trainer.stopped.update({int(index): reason for index, reason in before[1]["stopped"].items()})
            for name, one in self.kept.items():
                if before[1].get(name):
                    state = before[0].get(name, None)
                    one.load(state.to_dict() if state is not None else {}, before[1][name])

    @property
    def kept(self) -> Mapping[str, Halfway | Averaged]:
        """What is kept on the way."""
        return {"halfway": self.halfway, "averaged": self.averaged}

    @property
    def able(self) -> list[int]:
        """Candidates that were not stopped."""
        return [index for index in range(len(self.members)) if index not in self.trainer.stopped]

    @property
    def steps(self) -> int:
        """Control steps so far, of all candidates."""
        return (self.trainer.batches + self._extra) * self.trainer.steps_per_batch

    def train(self, progress: Share, log: Log | None) -> None:
        """All batches that are left."""
        trainer = self.trainer
        while trainer.batches < self.batches:
            stats = trainer.batch()
            self.history.append({"steps": stats.steps // len(self.members), **stats.values})
            if log is not None:
                log(stats, self.members)
            progress(trainer.batches / self.batches)
            self.halfway.look(trainer.batches, self.population, trainer.kl, self.able)
            self.averaged.look(trainer.batches, self.population)
            if trainer.batches < self.batches:
                self.saved.keep(trainer, self.history, self.kept)

    def finished(self) -> list[Finetuned]:
        """The candidates, inside their bounds; then those that were kept on the way, where they are inside."""
        self.averaged.put_into(self.population, self.able)
        kl = self._project()
        check_env(self.bare)
        std, anchor_std = (each.log_std().exp().mean((1, 2)).tolist() for each in (self.population, self.anchor))
        histories = [[_of_member(row, index) for row in self.history] for index in range(len(self.members))]
        ended = [
            Finetuned(
                member,
                self.population.candidate(index),
                kl[index],
                std[index],
                anchor_std[index],
                self.trainer.stopped.get(index),
                histories[index],
                prices={} if index in self.trainer.stopped else found_prices(histories[index], self.held),
            )
            for index, member in enumerate(self.members)
        ]
        inside = [one for one in self.halfway.moments if one.kl <= KL_SLACK * float(self.bounds[one.index])]
        return ended + [self._on_the_way(one, histories[one.index], anchor_std[one.index]) for one in inside]

    def _on_the_way(self, moment: Moment, history: list[dict[str, float]], anchor_std: float) -> Finetuned:
        """A candidate as it was then; history: of its whole training."""
        member, known = self.members[moment.index], history[: max(1, round(moment.share * self.batches))]
        named = replace(member, id=f"{member.id}-{percent(moment.share)}")
        prices = found_prices(known, self.held)
        return Finetuned(named, moment.tensors, moment.kl, moment.std, anchor_std, None, known, moment.share, prices)

    def _project(self) -> list[float]:
        """Measure the KL on fresh batches of the finished candidates' own states; project who ended beyond its bound.

        Who is inside stays as it is, however many batches the others take. Raises SimulationError as the trainer does
        if the KL of the last one that is left is not finite.
        """
        bounds = self.bounds.to(self.bare.device)
        found, inside = torch.full_like(bounds, torch.inf), torch.zeros_like(bounds, dtype=torch.bool)
        while True:
            observation = self.trainer.collect()["observation"].flatten(1, 2)
            self._extra += 1
            kl = mean_kl(self.population, self.anchor, observation)
            for index in torch.nonzero(~kl.isfinite()).flatten().tolist():
                self.trainer.stop(index, "its KL to the anchor is not finite when training ends")
                kl[index] = 0.0  # it is its anchor now
            found = torch.where(inside, found, kl)
            inside |= kl <= KL_SLACK * bounds
            if bool(inside.all()) or self._extra > MOST_PROJECTIONS:
                return found.tolist()
            project_to_kl_bound(self.population, self.anchor, observation, torch.where(inside, torch.inf, bounds))


def _of_member(row: Mapping[str, Any], index: int) -> dict[str, float]:
    """A row of the history as one candidate sees it."""
    return {name: (value[index] if isinstance(value, list) else value) for name, value in sorted(row.items())}
