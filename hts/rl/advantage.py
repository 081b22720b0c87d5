"""Generalised advantage estimation over [P, N, T], as TorchRL's `GAE(vectorized=False)` gives it."""

from __future__ import annotations

import torch
from tensordict import TensorDictBase
from torchrl.objectives.value.functional import generalized_advantage_estimate

from hts.rl.population import Population


def advantages(
    reward: torch.Tensor,
    value: torch.Tensor,
    next_value: torch.Tensor,
    terminated: torch.Tensor,
    done: torch.Tensor,
    gamma: float,
    lam: float,
) -> tuple[torch.Tensor, torch.Tensor]:
    """Advantage and value target, each [P, N, T].

    reward, value, terminated, done [P, N, T]; next_value [P, N, T]: V of the state that each step ended in, which at
    the end of an episode is the last one of the old episode. A time-out (done, not terminated) bootstraps from it, a
    fall from 0, whatever next_value is there: not even finite where the physics has diverged.
    """
    column = (..., None)
    next_value = next_value.masked_fill(terminated, 0.0)  # torchrl's product with 0 keeps a NaN
    # Step by step and not TorchRL's vectorised form, whose sums depend a little on the number of candidates.
    advantage, target = generalized_advantage_estimate(
        gamma, lam, value[column], next_value[column], reward[column], done[column], terminated[column]
    )
    return advantage.squeeze(-1), target.squeeze(-1)


def sparse_next_values(population: Population, data: TensorDictBase, value: torch.Tensor) -> torch.Tensor:
    """V of the state that each step ended in, [P, N, T], with few evaluations of the critic; value [P, N, T]: of the
    states that steps began in.

    A step ends where the next one begins. Evaluated are only the last step of the batch and the ends of episodes that
    timed out; after a fall the value is not used, and it is 0 here. Candidate by candidate, so that nobody's numbers
    depend on the others; waits for a GPU.
    """
    seen, truncated = data["next", "critic_observation"], data["next", "truncated"].squeeze(-1)
    last = population.value(seen[:, :, -1])
    following = torch.cat((value[..., 1:], last.unsqueeze(-1)), -1)
    following = following.masked_fill(data["next", "terminated"].squeeze(-1), 0.0)
    for index in truncated.flatten(1).any(1).nonzero().flatten().tolist():
        ends = truncated[index]
        following[index][ends] = population.value_of(index, seen[index][ends])
    return following
