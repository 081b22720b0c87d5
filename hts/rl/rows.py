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


def row_standardised(x: torch.Tensor) -> torch.Tensor:
    """[P, S] -> each row minus its mean, over its standard deviation; as it is where a row is one number, which has no
    deviation."""
    if x.shape[1] == 1:
        return x
    if x.device.type == "cpu":
        return torch.stack([(row - row.mean()) / (row.std() + 1e-8) for row in x.unbind(0)])
    return (x - x.mean(1, keepdim=True)) / (x.std(1, keepdim=True) + 1e-8)
