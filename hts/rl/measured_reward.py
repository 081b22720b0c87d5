"""A measured reward beside the task's own, as a TorchRL transform: r = r_task + lambda dt (r_measured - centre)."""

from __future__ import annotations

import math

import torch
from tensordict import TensorDictBase
from tensordict.utils import NestedKey
from torchrl.envs.transforms import Transform

from hts.rl.centring import RewardCentring
from hts.rl.given import OfItsSizes, as_numbers, check_number
from hts.rl.loss_checks import check_not_empty, first_bad

STEP_RATE = 2e-3  # beta per control step inside an env: about that of one update of 0.05 per batch of 24 steps


class MeasuredReward(OfItsSizes, Transform):
    """Adds lambda dt (r_measured - centre) to the reward.

    weight: lambda, reward per second and unit of the measured reward, a float or [P] (then every tensor begins with P);
    dt: control step, s: r_measured is a rate; in_key: where r_measured [..., 1] is written, by a transform before this
    one or by the env; centring: its running mean.

    Inside an env (`TransformedEnv`) each step's reward is changed, and the centre follows step by step at its `rate`.
    On a batch from a collector (called as a module) the centre is updated once with the whole batch and then
    subtracted; a batch that has its measured reward already is refused. Centred before anything else, never clipped. A
    reward that is not finite, measured or the task's, is refused in a batch, and in an env on a CPU: to ask at every
    step would wait for a GPU. Raises ValueError for a weight or dt that cannot be, and for weights of candidates with
    a centring of another number of them, TypeError for what is no number.
    """

    def __init__(
        self,
        weight: float | torch.Tensor,
        dt: float,
        *,
        in_key: NestedKey,
        reward_key: NestedKey = "reward",
        centring: RewardCentring | None = None,
    ) -> None:
        super().__init__(in_keys=[in_key, reward_key], out_keys=[reward_key])
        self.dt = dt
        self.register_buffer("weight", as_numbers("weight", weight, "a finite number, or [P] for P candidates"))
        if self.weight.ndim > 1 or not bool(self.weight.isfinite().all()):
            raise ValueError(f"weight is {self.weight.tolist()}; expected a finite number, or [P] for P candidates.")
        check_number("dt", dt, "the length of a control step, s")
        if not 0.0 < dt < math.inf:
            raise ValueError(f"dt is {dt}; expected the length of a control step, s.")
        count = self.weight.numel() if self.weight.ndim else None
        self.centring = centring if centring is not None else RewardCentring(STEP_RATE, count)
        self._rewarded: tuple[torch.Tensor, int, torch.Tensor] | None = None
        centres = self.centring.mean.numel()
        if count is not None and centres != count and self.centring.rate > 0.0:  # it would centre across candidates
            raise ValueError(
                f"weight is of {count} candidates, centring has {centres} mean{'s' * (centres > 1)}; expected one for "
                f"each candidate: RewardCentring({self.centring.rate:g}, count={count})."
            )

    def added(self, measured: torch.Tensor) -> torch.Tensor:
        """lambda dt (r_measured - centre), of measured's shape; with [P] weights its first dimension is P."""
        if self.weight.ndim and measured.shape[:1] != self.weight.shape:  # what broadcasts would be paid to others
            raise ValueError(
                f"The measured reward has the shape {tuple(measured.shape)}, weight is of {len(self.weight)} "
                "candidates; expected a batch that begins with them. With one weight for all, give a float."
            )
        centred = self.centring(measured)
        return self.weight.view(*self.weight.shape, *(1,) * (measured.ndim - self.weight.ndim)) * self.dt * centred

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        return self._with_reward(next_tensordict)

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """A batch of steps, as a collector gives it: changes ("next", reward_key)."""
        outcome = tensordict.get("next", None)
        if outcome is None:
            found = ", ".join(map(repr, tensordict.keys()))
            raise KeyError(f"The batch has no 'next', where its rewards are; it has {found}. A collector gives it.")
        check_not_empty(outcome.shape)
        self._with_reward(outcome, batch=True)
        return tensordict

    def _with_reward(self, outcome: TensorDictBase, batch: bool = False) -> TensorDictBase:
        measured_key, reward_key = self.in_keys
        for name, key in (("in_key", measured_key), ("reward_key", reward_key)):
            if outcome.get(key) is None:
                found = ", ".join(repr(one) for one in outcome.keys(True, True))
                raise KeyError(
                    f"{name} is {key!r}, which no step has; it has {found}. Name an entry that the env, or a transform "
                    "before this one, writes."
                )
        measured, task = outcome.get(measured_key), outcome.get(reward_key)
        if measured.shape != task.shape:  # what broadcasts would be added to the wrong steps, silently
            raise ValueError(
                f"in_key {measured_key!r} has the shape {tuple(measured.shape)}, the reward {tuple(task.shape)}: one "
                "number for each step is expected, so write both alike, [..., 1]."
            )
        if batch:
            self._refuse_twice(measured, task)
        if batch or measured.device.type == "cpu":
            _check_finite(measured_key, measured)
            _check_finite(reward_key, task)
        self.centring.update(measured)
        outcome.set(reward_key, task + self.added(measured))
        if batch:
            self._rewarded = measured.detach(), _version(measured), task.detach()
        return outcome

    def _refuse_twice(self, measured: torch.Tensor, task: torch.Tensor) -> None:
        """Raise ValueError for the batch that was rewarded last, unless its reward is what it was before: then it was
        put back. Collectors that write their batches into the same memory have written there since."""
        if self._rewarded is None:
            return
        known, version, before = self._rewarded
        if not _same_memory(known, measured) or version != _version(measured) or _same_memory(before, task):
            return
        if not torch.equal(before, task):
            raise ValueError(
                f"This batch has got the measured reward of {self.in_keys[0]!r} already, and would get it again. Call "
                "MeasuredReward once for each batch of a collector: before GAE, outside the loop over epochs."
            )

    def _reset(self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase) -> TensorDictBase:
        return tensordict_reset


def _check_finite(key: NestedKey, reward: torch.Tensor) -> None:
    """Raise ValueError for a reward that is not finite: what is learned from it is lost for good."""
    bad = ~reward.isfinite()
    if bool(bad.any()):
        raise ValueError(
            f"The reward {key!r} is {first_bad(reward, bad)}. Nothing may be learned from that: stop, and look at the "
            "env, or at the transform that writes it, such as a measurement model."
        )


def _same_memory(one: torch.Tensor, other: torch.Tensor) -> bool:
    return one.untyped_storage().data_ptr() == other.untyped_storage().data_ptr()


def _version(tensor: torch.Tensor) -> int:
    """How often it was changed in place; 0 where torch does not count."""
    return 0 if tensor.is_inference() else tensor._version
