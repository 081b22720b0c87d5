"""Reductions per candidate that give the same bits however many candidates there are.

Torch may order the sum over dimension 1 of [P, S] differently for different P. On the CPU each row is therefore
reduced alone; on a GPU, where nothing is bitwise repeatable anyway, all at once.
"""

from __future__ import annotations

import torch


def row_mean(x: torch.Tensor) -> torch.Tensor:
    """Mean over everything but the first dimension: [P, ...] -> [P]."""
    if x.device.type == "cpu":
        return torch.stack([row.mean() for row in x.unbind(0)])
    return x.flatten(1).mean(1)


def row_std(x: torch.Tensor) -> torch.Tensor:
    """Standard deviation over everything but the first dimension: [P, ...] -> [P]."""
    if x.device.type == "cpu":
        return torch.stack([row.std() for row in x.unbind(0)])
    return x.flatten(1).std(1)


def row_standardised(x: torch.Tensor, counted: torch.Tensor | None = None) -> torch.Tensor:
    """[P, S] -> each row minus its mean, over its standard deviation; as it is where a row is one number, which has no
    deviation. counted [P, S]: of which numbers; the others become 0."""
    if x.shape[1] == 1:
        return x
    if counted is not None:
        count = counted.sum(1, keepdim=True)
        per = x.shape[1] / count.clamp(min=1)  # from means over all to means over those that count
        mean = row_mean(torch.where(counted, x, 0.0)).unsqueeze(1) * per
        apart = torch.where(counted, x - mean, 0.0)
        variance = row_mean(apart.square()).unsqueeze(1) * x.shape[1] / (count - 1).clamp(min=1)
        return torch.where(count > 1, apart / (variance.sqrt() + 1e-8), x)
    if x.device.type == "cpu":
        return torch.stack([(row - row.mean()) / (row.std() + 1e-8) for row in x.unbind(0)])
    return (x - x.mean(1, keepdim=True)) / (x.std(1, keepdim=True) + 1e-8)
