"""Reward centring (Naik, Wan, Tomar, Sutton 2024, arXiv 2405.09999), simple on-policy form.

A learned measurement's zero moves with every new fit (it is z-scored by its data's statistics). Subtracting a running
mean removes that shift before anything else touches the reward; clipping first would not.
"""

from __future__ import annotations

import torch

from hts.rl.given import OfItsSizes, check_number
from hts.rl.rows import row_mean


class RewardCentring(OfItsSizes):
    """Running mean of a reward, of each candidate or of all, with the unbiased start beta_t = beta / o_t.

    o_t = o_{t-1} + beta (1 - o_{t-1}), o_0 = 0: the first mean is the first batch's own. Kept slow (small beta): with
    early termination a fast centre would change the value of staying alive.

    count: P, for rewards [P, ...] with a mean each; None: one mean of everything. rate: beta, per `update`; 0: no
    centring, the mean stays 0. Raises ValueError for a rate outside 0 to 1.
    """

    mean: torch.Tensor
    trace: torch.Tensor

    def __init__(self, rate: float = 0.05, count: int | None = None, device: torch.device | str | None = None) -> None:
        super().__init__()
        check_number("rate", rate, "the share of a batch in the mean, 0 to 1")
        if not 0.0 <= rate <= 1.0:
            raise ValueError(f"rate is {rate}, expected 0 (no centring) to 1 (the last batch's mean alone).")
        self.rate = rate
        self.register_buffer("mean", torch.zeros(() if count is None else (count,), device=device))
        self.register_buffer("trace", torch.zeros((), device=device))

    @torch.no_grad()
    def update(self, reward: torch.Tensor, counted: torch.Tensor | None = None) -> None:
        """Fold in a reward [P, ...] (any shape without `count`); counted, of its shape: only where True. Raises
        ValueError for another P, and for no reward at all, whose mean is NaN for good."""
        if self.mean.ndim and reward.shape[:1] != self.mean.shape:
            raise ValueError(
                f"The reward has the shape {tuple(reward.shape)}, expected one that begins with the candidates, "
                f"{len(self.mean)}: there is a mean for each of them. With one weight for all, give a float."
            )
        if reward.numel() == 0:
            raise ValueError(
                f"The reward has the shape {tuple(reward.shape)}, nothing is in it; expected that of one step "
                "at least. Leave an empty batch out."
            )
        if self.rate == 0.0:
            return
        mean_of = row_mean if self.mean.ndim else torch.mean
        if counted is None:
            mean = mean_of(reward)
        else:
            share = mean_of(counted.to(reward.dtype))
            mean = torch.where(share > 0, mean_of(torch.where(counted, reward, 0.0)) / share, self.mean)
        self.trace = self.trace + self.rate * (1.0 - self.trace)
        mean = self.mean + self.rate / self.trace * (mean - self.mean)
        self.mean = mean.to(self.mean.dtype)  # of rewards in another precision too: a saved state is what goes on

    def forward(self, reward: torch.Tensor) -> torch.Tensor:
        """reward - mean, of the same shape. Changes nothing."""
        return reward - self.mean.view(*self.mean.shape, *(1,) * (reward.ndim - self.mean.ndim))
