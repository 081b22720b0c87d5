"""Transforms whose outputs nobody needs before a batch is complete."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterable, Mapping

import torch
from tensordict import TensorDictBase
from tensordict.utils import NestedKey
from torchrl.envs import EnvBase
from torchrl.envs.transforms import Transform, TransformedEnv

from hts.rl.task_env import ReplacedState


class DeferrableTransform(Transform):
    """Adds entries to each step that neither the policy nor the env reads, such as a measured reward.

    A subclass says what it reads of a step (`record`), what it makes of it (`evaluate`, which may change a memory of
    each env instance), and how that memory is emptied (`forget`). Inside a plain `TransformedEnv` this happens step by
    step; a collector may record every step and evaluate a whole batch at once (`forward_sequence`), to the same bits.
    """

    @abstractmethod
    def record(self, channels: Mapping[str, torch.Tensor]) -> torch.Tensor:
        """What `evaluate` wants of a step, [P·N, ...]; channels: name -> [P, N, ...]. It stays as it is while later
        steps are taken."""

    @abstractmethod
    def evaluate(self, recorded: torch.Tensor) -> dict[NestedKey, torch.Tensor]:
        """The entries of one step, each [P·N, 1], in the order of `out_keys`; never waits for a GPU."""

    @abstractmethod
    def forget(self, ended: torch.Tensor) -> None:
        """Empty the memory of the env instances of ended, bool [P·N]."""

    def forward_sequence(self, recorded: torch.Tensor, ended: torch.Tensor) -> dict[NestedKey, torch.Tensor]:
        """`evaluate`, then `forget`, for T steps one after the other: recorded [T, P·N, ...], ended [T, P·N] -> entries
        [T, P·N, 1]. A subclass may do the same, to the same bits, in fewer operations."""
        steps: list[dict[NestedKey, torch.Tensor]] = []
        for each, over in zip(recorded, ended, strict=True):
            steps.append(self.evaluate(each))
            if bool(over.any()):
                self.forget(over)
        return {key: torch.stack([step[key] for step in steps]) for key in steps[0]}

    def prepare(self, instances: int, device: torch.device) -> None:
        """Make a memory for so many env instances, P·N, on a device, if there is none yet."""

    @property
    def savable(self) -> bool:
        """Whether `state_dict` holds all that it remembers, so that a training can be saved in mid-episode."""
        return True

    def source_of(self, key: NestedKey, outcome: TensorDictBase) -> str:
        """Whose code made an entry that is no number, in words for a message; outcome: steps with all entries."""
        return type(self).__name__

    def replaced_state(self) -> list[ReplacedState]:
        """The memory that a step replaces instead of changing it in place, once it has been prepared."""
        return []

    # ------------------------------------------------------------------------------------- inside an env, step by step

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        shape = next_tensordict.batch_size
        recorded = self.record(next_tensordict["channels"])
        self.prepare(shape.numel(), recorded.device)
        for key, value in self.evaluate(recorded).items():
            next_tensordict.set(key, value.view(*shape, 1))
        return next_tensordict

    def _reset(self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase) -> TensorDictBase:
        mask = tensordict.get("_reset", None)
        shape = tensordict_reset.batch_size
        if mask is None:
            mask = torch.ones(shape, dtype=torch.bool, device=tensordict_reset.device)
        self.forget(mask.reshape(-1))
        for key in self.out_keys:
            tensordict_reset.set(key, torch.zeros(*shape, 1, device=tensordict_reset.device))
        return tensordict_reset

    # An env that resets itself hands the same mask to the same work.
    def _reset_on_native_autoreset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        return self._reset(tensordict, tensordict_reset)


def base_and_transforms(env: EnvBase) -> tuple[EnvBase, list[Transform]]:
    """The env itself, and the transforms around it from inside out."""
    if not isinstance(env, TransformedEnv):
        return env, []
    base, inner = base_and_transforms(env.base_env)
    transform = env.transform
    return base, [*inner, *(transform if isinstance(transform, Iterable) else [transform])]


def source_of(env: EnvBase, key: NestedKey, outcome: TensorDictBase) -> str | None:
    """Whose code made an entry of outcome, as the transform around env that writes it says; None if none of them does,
    but the env itself."""
    for transform in base_and_transforms(env)[1]:
        if isinstance(transform, DeferrableTransform) and key in transform.out_keys:
            return transform.source_of(key, outcome)
    return None
