"""Two small running states: the Lagrange multiplier of a bound on the KL, and the running mean of a reward."""

from __future__ import annotations

import math

import torch

from hts_rsl_rl.errors import AnchorError

AS_TEXT = " In YAML a number with an exponent needs a point (1.0e-2), and infinity is .inf."
LARGEST_EXCESS = 2.0  # of KL / c - 1 in one update: one bad batch must not spend the training on getting back


class LagrangeMultiplier:
    """alpha <- [alpha + eta (KL / c - 1)]_+, once per batch.

    bound: c, nats, infinity for no bound; rate: eta. It acts on KL / c, so that tight and loose bounds are approached
    in the same number of batches; alpha starts at 0: nothing pulls until the bound is near.
    """

    def __init__(self, bound: float, rate: float = 0.05) -> None:
        if not is_number(bound) or not bound > 0:
            raise AnchorError(
                f"kl_bound is {bound!r}; expected a positive number of nats, infinity for no bound.{AS_TEXT}"
            )
        if not is_number(rate) or not 0 <= rate < math.inf:
            raise AnchorError(f"multiplier_rate is {rate!r}; expected a number, 0 or more.{AS_TEXT}")
        self.bound, self.rate, self.value = float(bound), float(rate), 0.0

    def update(self, kl: float) -> float:
        """kl: mean over the batch's states with the parameters after its steps, nats; returns the new value."""
        if not math.isfinite(kl):
            raise AnchorError(
                f"The KL to the anchor is {kl}: the policy is no longer finite. Go back to the last checkpoint and "
                "lower learning_rate."
            )
        if math.isfinite(self.bound):
            excess = min(kl / self.bound - 1.0, LARGEST_EXCESS)
            self.value = max(0.0, self.value + self.rate * excess)
        return self.value


class RunningMean:
    """Mean of a reward with the unbiased start beta_t = beta / o_t, o_t = o_{t-1} + beta (1 - o_{t-1}), o_0 = 0.

    Reward centering of Naik, Wan, Tomar and Sutton 2024 (arXiv 2405.09999), simple on-policy form. rate: beta, per
    `update`; the first mean is that of the first update.
    """

    def __init__(self, rate: float, device: torch.device | str = "cpu") -> None:
        if not is_number(rate) or not 0 < rate <= 1:
            raise AnchorError(f"The rate of centring is {rate!r}; expected a number above 0, at most 1.{AS_TEXT}")
        self.rate = rate
        self.mean, self.trace = torch.zeros((), device=device), torch.zeros((), device=device)

    @torch.no_grad()
    def update(self, mean: torch.Tensor) -> None:
        """Fold in the mean of a batch, or of one step over all env instances; 0-dimensional."""
        self.trace = self.trace + self.rate * (1.0 - self.trace)
        self.mean = self.mean + self.rate / self.trace * (mean - self.mean)


def is_number(value: object) -> bool:
    """Whether a setting is a number: YAML makes a text of 1e-2, and a yes is no number."""
    return isinstance(value, int | float) and not isinstance(value, bool)
