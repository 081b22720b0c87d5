"""A measured reward beside the task's own, as a TorchRL transform: r = r_task + lambda dt (r_measured - centre)."""

from __future__ import annotations

import math

import torch
from tensordict import TensorDictBase
from tensordict.utils import NestedKey
from torchrl.envs.transforms import Transform

from hts.rl.centring import RewardCentring

STEP_RATE = 2e-3  # beta per control step inside an env: about that of one update of 0.05 per batch of 24 steps


class MeasuredReward(Transform):
    """Adds lambda dt (r_measured - centre) to the reward.

    weight: lambda, reward per second and unit of the measured reward, a float or [P] (then every tensor begins with P);
    dt: control step, s: r_measured is a rate; in_key: where r_measured [..., 1] is written, by a transform before this
    one or by the env; centring: its running mean.

    Inside an env (`TransformedEnv`) each step's reward is changed, and the centre follows step by step at its `rate`.
    On a batch from a collector (called as a module) the centre is updated once with the whole batch and then
    subtracted. Centred before anything else, never clipped; NaN stays NaN, so that it can be found. Raises ValueError
    for a weight or dt that cannot be, and for weights of candidates with a centring of another number of them.
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
        self.register_buffer("weight", torch.as_tensor(weight, dtype=torch.get_default_dtype()))
        if self.weight.ndim > 1 or not bool(self.weight.isfinite().all()):
            raise ValueError(f"weight is {self.weight.tolist()}; expected a finite number, or [P] for P candidates.")
        if not 0.0 < dt < math.inf:
            raise ValueError(f"dt is {dt}; expected the length of a control step, s.")
        count = self.weight.numel() if self.weight.ndim else None
        self.centring = centring if centring is not None else RewardCentring(STEP_RATE, count)
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
        self._with_reward(outcome)
        return tensordict

    def _with_reward(self, outcome: TensorDictBase) -> TensorDictBase:
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
        self.centring.update(measured)
        outcome.set(reward_key, task + self.added(measured))
        return outcome

    def _reset(self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase) -> TensorDictBase:
        return tensordict_reset
