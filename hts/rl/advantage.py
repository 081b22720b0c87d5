"""Generalised advantage estimation over [P, N, T], with bootstrapping at time-outs."""

from __future__ import annotations

import torch
from torchrl.objectives.value.functional import generalized_advantage_estimate


def advantages(
    reward: torch.Tensor, value: torch.Tensor, last_value: torch.Tensor, terminated: torch.Tensor,
    truncated: torch.Tensor, gamma: float, lam: float,
) -> tuple[torch.Tensor, torch.Tensor]:  # fmt: skip
    """Advantage and value target, each [P, N, T].

    reward, value, terminated, truncated [P, N, T]; last_value [P, N]: V of the state after the last step.
    Where an episode timed out, r <- r + gamma V(s): the state after it is already a new episode's, and one step
    earlier is a good stand-in (rsl_rl does the same).
    """
    done = terminated | truncated
    reward = reward + gamma * value * truncated
    next_value = torch.cat((value[..., 1:], last_value.unsqueeze(-1)), -1)
    column = (..., None)
    # Step by step and not TorchRL's vectorised form, whose sums depend a little on the number of candidates.
    advantage, target = generalized_advantage_estimate(
        gamma, lam, value[column], next_value[column], reward[column], done[column], done[column]
    )
    return advantage.squeeze(-1), target.squeeze(-1)
