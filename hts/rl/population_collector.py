"""A TorchRL collector for populations: to the bit the batches of TorchRL's `Collector`, with less between steps.

TorchRL's `Collector` puts each step together as nested TensorDicts and asks after each one whether an episode has
ended. `PopulationCollector` steps a `SplitStepEnv` by its parts and does in a step only what the next step waits for;
the rest is done once per batch, in fewer and larger operations. `hts.rl.captured_collector` launches each step as CUDA
graphs.
"""

from __future__ import annotations

import itertools
from collections import OrderedDict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from threading import Lock
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from tensordict.utils import unravel_key
from torchrl.collectors import BaseCollector, Collector
from torchrl.envs import EnvBase

from hts.rl.actor import PopulationActor, log_prob
from hts.rl.collector_checks import (
    FLAGS,
    Key,
    Said,
    check_flags,
    check_frames,
    check_policy,
    check_seen,
    checked_rewards,
    weights_of,
)
from hts.rl.deferred import DeferrableTransform, base_and_transforms
from hts.rl.random import EXPLORATION_SEED
from hts.rl.task_env import SplitStepEnv
from hts.rl.threads import pool


def can_split(env: EnvBase) -> bool:
    """Whether a collector may step env by its parts: a `SplitStepEnv` with none but deferrable transforms around it."""
    bare, transforms = base_and_transforms(env)
    return isinstance(bare, SplitStepEnv) and all(isinstance(one, DeferrableTransform) for one in transforms)


def torchrl_collector(env: EnvBase, actor: TensorDictModuleBase, frames_per_batch: int) -> Collector:
    """TorchRL's own collector of endless batches [P, N, T], set up for envs and actors of populations."""
    device = env.device or torch.device("cpu")
    return Collector(
        env,
        actor,
        frames_per_batch=frames_per_batch,
        total_frames=-1,
        device=device,
        track_traj_ids=False,
        trust_policy=True,
        use_buffers=False,
        track_policy_version=False,
        return_same_td=device.type != "cuda",  # each batch is a fresh one, so there is nothing to copy it for
        auto_register_policy_transforms=False,  # nothing here is recurrent: the memory is the transform's own
    )


class SplitStepCollector(BaseCollector):
    """What collectors that step an env by its parts share; see `PopulationCollector`."""

    def __init__(self, env: EnvBase, policy: PopulationActor, *, frames_per_batch: int, total_frames: int = -1) -> None:
        super().__init__()
        bare, transforms = base_and_transforms(env)
        if not can_split(env):
            strangers = [type(one).__name__ for one in transforms if not isinstance(one, DeferrableTransform)]
            raise TypeError(
                f"{type(self).__name__} steps an env by its parts: expected a SplitStepEnv with deferrable transforms, "
                f"found {' + '.join([type(bare).__name__, *strangers])}. Take torchrl.collectors.Collector."
            )
        assert isinstance(bare, SplitStepEnv)
        per_step = bare.batch_size.numel()
        check_frames(frames_per_batch, total_frames, per_step)
        check_policy(bare, policy)
        self.env, self.policy = env, policy
        self.bare_env = bare
        self.transforms: list[DeferrableTransform] = list(transforms)
        self.horizon = frames_per_batch // per_step
        self.frames_per_batch = self.requested_frames_per_batch = frames_per_batch
        self.total_frames = total_frames
        self._frames = 0
        self._begun = self._closed = self._env_closed = False

    @property
    def captured(self) -> bool:
        """Whether steps are graphs, so that every batch lies where the last one lay."""
        return False

    # -------------------------------------------------------------------------------------------------- iteration

    def iterator(self) -> Iterator[TensorDictBase]:
        """Batches [P, N, T] until total_frames are reached, without end if they are -1. Each goes on where the last one
        ended.

        Of every step: observation, critic_observation, loc, action, action_log_prob, the flags, and under "next":
        reward, the flags, the observations that the step ended in (of the old episode where it ended one), and the
        entries that transforms add.
        """
        while self.total_frames < 0 or self._frames < self.total_frames:
            if self.pre_collect_hook is not None:
                self.pre_collect_hook()
            batch = self.collect()
            self._frames += self.frames_per_batch
            if self.post_collect_hook is not None:
                self.post_collect_hook(batch)
            yield batch

    @torch.no_grad()
    def collect(self) -> TensorDict:
        """The next T steps of every env instance. Raises RuntimeError after `shutdown`."""
        if self._closed:
            raise RuntimeError(f"{type(self).__name__} was shut down: make another one to collect more.")
        self.update_policy_weights_()
        if not self._begun:
            self._begun = True
            instances = self.bare_env.batch_size.numel()
            for transform in self.transforms:
                transform.prepare(instances, self.bare_env.device)
            self.bare_env.reset()  # goes on where a saved state ended, if one was loaded
            self._begin()
        return self._collect()

    def _begin(self) -> None:
        """After the first episodes have begun."""

    def _collect(self) -> TensorDict:
        raise NotImplementedError

    def _batch(self, rows: Mapping[Key, torch.Tensor]) -> TensorDict:
        """rows [P, N, T, ...] by key, as a TensorDict. The flags at a step's beginning are always false."""
        shape = torch.Size((*self.bare_env.batch_size, self.horizon))
        begun = torch.zeros((), dtype=torch.bool, device=self.bare_env.device).expand(*shape, 1)
        batch: dict[str, Any] = dict.fromkeys(FLAGS, begun) | {"next": {}}
        for key, value in rows.items():
            place = batch
            for name in key[:-1]:
                place = place.setdefault(name, {})
            place[key[-1]] = value
        return TensorDict(batch, batch_size=shape, device=self.bare_env.device)

    # ------------------------------------------------------------------------------------------------- BaseCollector

    def update_policy_weights_(  # type: ignore[override]
        self, policy_or_weights: Any = None, *, policy: Any = None, weights: Any = None
    ) -> None:
        """Collect with the policy's parameters as they are now; each batch begins with it. Weights given here are
        loaded into the policy first: a module of the same kind, its state dict, or a TensorDict of its parameters and
        buffers. Raises TypeError for anything else, ValueError for the weights of another kind of module."""
        given = next((one for one in (policy_or_weights, policy, weights) if one is not None), None)
        if given is not None:
            self.policy.load_state_dict(weights_of(given, self.policy))
        self.policy.population.refresh()

    def set_seed(self, seed: int, static_seed: bool = False) -> int:
        """Seed the env and, from another seed, the exploration noise: neither repeats the other's numbers."""
        after = self.env.set_seed(seed, static_seed=static_seed)
        if self.policy.random is not None:
            self.policy.random.seed(seed + EXPLORATION_SEED)
        return after

    def state_dict(self) -> OrderedDict:
        """Env, memory of transforms, exploration noise and frames: everything to go on from here but the policy.
        Raises RuntimeError for an env that cannot be saved in mid-episode."""
        env = self.bare_env.full_state()
        if env is None:
            raise RuntimeError(
                f"{type(self.bare_env).__name__} cannot be saved in mid-episode: its full_state() says nothing. Write "
                "full_state() and load_full_state() of the env, or save without the collector and begin new episodes."
            )
        noise = {} if self.policy.random is None else self.policy.random.state_dict()
        memory = [dict(transform.state_dict()) for transform in self.transforms]
        return OrderedDict(env_state_dict=env, transforms=memory, noise=noise, frames=self._frames)

    def load_state_dict(self, state_dict: Mapping[str, Any]) -> None:  # type: ignore[override]
        """Go on from `state_dict`. Raises RuntimeError once steps have been captured, which keep the memory that they
        were captured with: make another collector for it."""
        if self.captured:
            raise RuntimeError(
                f"{type(self).__name__} has captured its steps, which would go on from where they are: load a state "
                "into a new collector, before its first batch."
            )
        go_on = self.bare_env.load_full_state if self._begun else self.bare_env.go_on  # no reset comes after the first
        go_on(state_dict["env_state_dict"])
        instances = self.bare_env.batch_size.numel()
        for transform, memory in zip(self.transforms, state_dict["transforms"], strict=True):
            if not memory.keys() <= transform.state_dict().keys():  # a memory that is not made yet takes no state
                transform.prepare(instances, self.bare_env.device)
            transform.load_state_dict(memory)
        if self.policy.random is not None:
            self.policy.random.load_state_dict(state_dict["noise"])
        self._frames = int(state_dict["frames"])

    def shutdown(self, timeout: float | None = None, close_env: bool = True, raise_on_error: bool = True) -> None:
        """Collect no more, and close the env, once."""
        self._closed = True
        if close_env and not self._env_closed:
            self._env_closed = True
            self.env.close()


@dataclass
class _Collected:
    """T steps of a group of candidates. rows: by key, [P, N, T, ...], or [T, P, N, ...] where the key begins with
    "next"; rewards [T, P, N]; recorded: of each transform, [T, P·N, ...]."""

    rows: dict[Key, torch.Tensor]
    rewards: torch.Tensor
    recorded: list[torch.Tensor]


class PopulationCollector(SplitStepCollector):
    """Batches [P, N, T] of a population, on a CPU.

        collector = PopulationCollector(env, PopulationActor(population, noise), frames_per_batch=P * N * T)
        for data in collector: ...

    env: a `SplitStepEnv`, with deferrable transforms around it if any; policy: whose exploration noise comes from a
    generator per candidate; frames_per_batch: P N T. Rewards and the transforms' entries are evaluated once a batch.
    Parameters are read at the beginning of each batch. An env that consists of groups has each of them stepped by a
    thread of its own.

    Raises RuntimeError, with the first batch, for an env that changes in place what it said of an earlier step.
    """

    def __init__(self, env: EnvBase, policy: PopulationActor, *, frames_per_batch: int, total_frames: int = -1) -> None:
        super().__init__(env, policy, frames_per_batch=frames_per_batch, total_frames=total_frames)
        groups = self.bare_env.groups()
        ends = list(itertools.accumulate(group.batch_size[0] for group in groups))
        members = [slice(begin, end) for begin, end in itertools.pairwise((0, *ends))]
        self._groups = [(group, policy.of(own)) for group, own in zip(groups, members, strict=True)]
        self._turn = Lock()
        self._checked = False
        self._pool = pool(max(len(groups), len(self.transforms)))

    def shutdown(self, timeout: float | None = None, close_env: bool = True, raise_on_error: bool = True) -> None:
        """Let go of threads, which may still be in another group's physics when one has failed, then close the env."""
        self._pool.shutdown()
        super().shutdown(timeout, close_env, raise_on_error)

    def _collect(self) -> TensorDict:
        run = map if len(self._groups) == 1 else self._pool.map
        collected = list(run(self._steps, *zip(*self._groups, strict=True)))
        self._checked = True
        recorded = [_joined(parts, 1) for parts in zip(*(one.recorded for one in collected), strict=True)]
        rows = {key: _joined([one.rows[key] for one in collected], _candidates(key)) for key in collected[0].rows}
        rows = {key: value.movedim(0, 2) if _candidates(key) else value for key, value in rows.items()}
        ended = rows["next", "done"].movedim(2, 0).reshape(self.horizon, -1)
        # What transforms make of the batch is computed beside the rest of it:
        # the physics is done, and the other cores are free.
        late = [
            self._pool.submit(_sequence, transform, row, ended)
            for row, transform in zip(recorded, self.transforms, strict=True)
        ]
        entries: dict[Key, torch.Tensor] = {("reward",): _joined([one.rewards for one in collected], 1)}
        for result in late:
            entries |= result.result()
        for key, value in entries.items():
            # Laid out alike however many candidates there are: sums take the order of the memory.
            rows[unravel_key(("next", key))] = (
                value.view(self.horizon, *self.bare_env.batch_size, 1).movedim(0, 2).contiguous()
            )
        return self._batch(rows)

    @torch.no_grad()  # each thread has a switch of its own
    def _steps(self, env: SplitStepEnv, policy: PopulationActor) -> _Collected:
        """The next T steps of a group. Only its physics runs beside that of the others: Python's lock is handed over
        once and not at every operation."""
        steps: dict[Key, list[torch.Tensor]] = {}
        recorded: list[list[torch.Tensor]] = [[] for _ in self.transforms]
        rewarded: list[Any] = []
        said: Said | None = None
        log_std = policy.log_std(ndim=3)
        std = log_std.exp()
        with self._turn:
            for _ in range(self.horizon):
                step, inputs = decide(env, policy, std)
                self._turn.release()
                try:
                    env.simulate(inputs)
                finally:
                    self._turn.acquire()
                ended, flags = env.end_step(step["action",])
                if not self._checked:
                    check_flags(env, flags)
                rewarded.append(ended)
                if self.transforms:
                    channels = env.channel_values()
                    for row, transform in zip(recorded, self.transforms, strict=True):
                        row.append(transform.record(channels))
                step |= {("next", name): value for name, value in (*env.observations().items(), *flags.items())}
                for key, value in step.items():
                    steps.setdefault(key, []).append(value)
                if not self._checked and said is None:
                    said = Said.of(env, step, ended)
                if bool(flags["done"].any()):
                    env.start_episodes(flags["done"].squeeze(-1))
        rows = {key: torch.stack(values, 0 if _candidates(key) else 2) for key, values in steps.items()}
        rows["action_log_prob",] = log_prob(rows["action",], rows["loc",], log_std.unsqueeze(2))
        rewards = checked_rewards(env, rewarded)
        if said is not None:
            said.check(env, {key: values[0] for key, values in steps.items()}, rewards[0])
        return _Collected(rows, rewards, [torch.stack(row) for row in recorded])


def decide(
    env: SplitStepEnv, policy: PopulationActor, std: torch.Tensor
) -> tuple[dict[Key, torch.Tensor], torch.Tensor]:
    """A step before its physics: what was seen and done, by key, and the simulator's inputs. std [P, 1, A]: of the
    exploration noise."""
    seen = env.observations()
    check_seen(env, policy, seen)
    loc = policy.loc(seen["observation"])
    action = loc if policy.random is None else loc + std * policy.random.normal(*loc.shape[1:])
    step: dict[Key, torch.Tensor] = {(name,): value for name, value in seen.items()}
    return step | {("loc",): loc, ("action",): action}, env.begin_step(action)


def _candidates(key: Key) -> int:
    """Which dimension of a group's rows is that of candidates: behind time under "next", which is seldom read as a
    whole and keeps the order of time in memory, one plain copy."""
    return int(key[0] == "next")


def _joined(parts: Sequence[torch.Tensor], dim: int) -> torch.Tensor:
    """One group's tensor as it is, those of several one behind the other."""
    return parts[0] if len(parts) == 1 else torch.cat(list(parts), dim)


@torch.no_grad()
def _sequence(transform: DeferrableTransform, recorded: torch.Tensor, ended: torch.Tensor) -> dict[Any, torch.Tensor]:
    """What a transform makes of T recorded steps."""
    return transform.forward_sequence(recorded, ended)
