"""Reward centring (Naik, Wan, Tomar, Sutton 2024, arXiv 2405.09999), simple on-policy form.

The measurement model's zero moves with every new fit (it is z-scored by its data's statistics). Subtracting a
running mean of r_real removes that shift before anything else touches the reward; clipping first would not.
"""

from __future__ import annotations

import torch

from hts.rl.rows import row_mean


class Centre:
    """Running mean of r_real per candidate [P], with the unbiased start beta_t = beta / o_t.

    o_t = o_{t-1} + beta (1 - o_{t-1}), o_0 = 0. Kept slow (small beta): with early termination a fast centre would
    change the value of staying alive.
    """

    def __init__(self, count: int, rate: float, device: torch.device):
        self.rate = rate
        self.mean = torch.zeros(count, device=device)
        self.trace = torch.zeros((), device=device)

    def update(self, reward: torch.Tensor) -> None:
        """reward [P, ...]: r_real of a batch."""
        self.trace = self.trace + self.rate * (1.0 - self.trace)
        self.mean = self.mean + self.rate / self.trace * (row_mean(reward) - self.mean)

    def state_dict(self) -> dict[str, torch.Tensor]:
        return {"mean": self.mean.clone(), "trace": self.trace.clone()}

    def load_state_dict(self, state) -> None:
        self.mean = state["mean"].to(self.mean.device).clone()
        self.trace = state["trace"].to(self.mean.device).clone()
