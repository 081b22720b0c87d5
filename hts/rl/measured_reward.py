"""A measured reward beside the task's own, as a TorchRL transform: r = r_task + lambda dt (r_measured - centre)."""

from __future__ import annotations

import math

import torch
from tensordict import TensorDictBase
from tensordict.utils import NestedKey
from torchrl.data import Composite, Unbounded
from torchrl.envs.transforms import Transform

from hts.rl.centring import RewardCentring
from hts.rl.counted import counted
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
    subtracted; steps that TorchRL's masks leave out (those that stretches are filled up with) are neither paid nor in
    the centre. Centred before anything else, never clipped. A reward that is not finite, measured or the task's, is
    refused in a batch, and in an env on a CPU: to ask at every step would wait for a GPU. The reward keeps its dtype.

    Either way the reward as it was goes into an entry of its own beside it, `before_key`: "reward_before_effort" of
    reward_key "reward" and in_key "effort", parts of nested keys joined by "__"; one number a step, without the last
    dimension that vectors have, so that what gathers an env's vectors (`CatTensors`) leaves it out of what a policy
    sees. A batch, or a part or copy of one, that has it and whose reward is another now, has got its measured reward
    already and is refused.

    Raises ValueError for a weight or dt that cannot be, and for weights of candidates with a centring of another number
    of them, TypeError for what is no number.
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
        self.before_key = f"{_flat(reward_key)}_before_{_flat(in_key)}"
        super().__init__(in_keys=[in_key, reward_key], out_keys=[reward_key, self.before_key])
        self.dt = dt
        self.register_buffer("weight", as_numbers("weight", weight, "a finite number, or [P] for P candidates"))
        if self.weight.ndim > 1 or not bool(self.weight.isfinite().all()):
            raise ValueError(f"weight is {self.weight.tolist()}; expected a finite number, or [P] for P candidates.")
        check_number("dt", dt, "the length of a control step, s")
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
        """A batch of steps, as a collector gives it: changes ("next", reward_key), adds ("next", before_key). Raises
        KeyError naming what it lacks, ValueError for one that is empty, not finite, of other shapes, or rewarded."""
        outcome = tensordict.get("next", None)
        if outcome is None:
            found = ", ".join(map(repr, tensordict.keys()))
            raise KeyError(f"The batch has no 'next', where its rewards are; it has {found}. A collector gives it.")
        check_not_empty(outcome.shape)
        self._with_reward(outcome, batch=tensordict)
        return tensordict

    def _with_reward(self, outcome: TensorDictBase, batch: TensorDictBase | None = None) -> TensorDictBase:
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
        steps = None if batch is None else counted(batch, measured.shape)
        if batch is not None:
            self._refuse_twice(outcome, task)
        if batch is not None or measured.device.type == "cpu":
            _check_finite(measured_key, measured, steps)
            _check_finite(reward_key, task, steps)
        self.centring.update(measured, steps)
        added = self.added(measured)
        if steps is not None:
            added = torch.where(steps, added, 0.0)
        outcome.set(reward_key, task + (added.to(task.dtype) if task.is_floating_point() else added))
        outcome.set(self.before_key, _numbers(task.detach(), outcome.batch_dims))
        return outcome

    def _refuse_twice(self, outcome: TensorDictBase, task: torch.Tensor) -> None:
        """Raise ValueError for what has got its measured reward, unless its reward is what it was before: then it was
        put back."""
        before, now = outcome.get(self.before_key, None), _numbers(task, outcome.batch_dims)
        if before is not None and (before.shape != now.shape or bool((before != now).any())):
            raise ValueError(
                f"This batch has got the measured reward of {self.in_keys[0]!r} already ('next' has "
                f"{self.before_key!r}), and would get it again. Call MeasuredReward once for each batch of a "
                "collector: before GAE, outside the loop over epochs, and not where the env has it. Of a collector "
                "with return_same_td=True, give it data.copy() and go on with that."
            )

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        """With before_key. Raises ValueError where another MeasuredReward of the env adds the same."""
        if self.before_key in list(observation_spec):
            raise ValueError(
                f"The env has {self.before_key!r}: it adds the measured reward of {self.in_keys[0]!r} already. Leave "
                "one MeasuredReward out."
            )
        reward = self._numbers_of_env()
        observation_spec[self.before_key] = Unbounded(reward.shape, dtype=reward.dtype, device=reward.device)
        return observation_spec

    def _reset(self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase) -> TensorDictBase:
        return tensordict_reset.set(self.before_key, self._numbers_of_env())

    def _numbers_of_env(self) -> torch.Tensor:
        return _numbers(self.parent.full_reward_spec[self.in_keys[1]].zero(), len(self.parent.batch_size))


def _check_finite(key: NestedKey, reward: torch.Tensor, steps: torch.Tensor | None) -> None:
    """Raise ValueError for a reward that is not finite, of the steps that count: what is learned from it is lost for
    good."""
    bad = ~reward.isfinite()
    if steps is not None:
        bad &= steps
    if bool(bad.any()):
        raise ValueError(
            f"The reward {key!r} is {first_bad(reward, bad)}. Nothing may be learned from that: stop, and look at the "
            "env, or at the transform that writes it, such as a measurement model."
        )


def _numbers(reward: torch.Tensor, batch_dims: int) -> torch.Tensor:
    """One number a step, [...], of rewards [..., 1]."""
    return reward.squeeze(-1) if reward.ndim > batch_dims else reward


def _flat(key: NestedKey) -> str:
    return key if isinstance(key, str) else "__".join(key)  # ("a", "b") is not "a_b"
