"""The one place where a model's doubt becomes reward.

A policy that is trained against a model looks for its mistakes: where the model errs in the policy's favour, the reward
is too high. With β > 0 the reward is that of the worse of the two ends of mean ± β standard deviations, so what the
model does not know does not pay:

    r_real = min( reward(ẑ + β σ̂), reward(ẑ − β σ̂) )

For a cost (reward −ẑ) that is −(ẑ + β σ̂): the mean plus β standard deviations of the cost. Nothing needs to be known
about the reward, and with β = 0, or a model without σ̂, it is reward(ẑ) to the bit.
"""

from __future__ import annotations

from collections.abc import Callable

import torch

from hts.contracts import Prediction


def pessimistic_reward(
    reward: Callable[[torch.Tensor], torch.Tensor], prediction: Prediction, beta: float
) -> torch.Tensor:
    """r_real of predictions of any shape, same shape; NaN stays NaN."""
    mean, std = prediction
    if std is None or beta == 0.0:
        return reward(mean)
    return torch.minimum(reward(mean + beta * std), reward(mean - beta * std))  # minimum keeps NaN
