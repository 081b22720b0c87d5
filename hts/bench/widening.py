"""The same function in larger networks, so that benches of any size have a robot that walks."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

import torch
from torch import Tensor

from hts.errors import ConfigError
from hts.rl.population import Sizes

LOWEST = 1.0  # ELU's outputs lie above minus this


def widened(sizes: Sizes, tensors: Mapping[str, Tensor], hidden: tuple[int, ...]) -> tuple[Sizes, dict[str, Tensor]]:
    """A policy's actor and critic in networks with `hidden` layers, each at least as wide,
    and at least as many of them.

    Added units get small random weights and are not listened to. An added layer hands its inputs on: they are outputs
    of an ELU, so x + 1 > 0 and ELU(x + 1) = x + 1; the bias of the layer after it takes the 1 back. Every gradient is
    computed as in any network of that size. Raises ConfigError where a layer would be narrower.
    """
    old = sizes.hidden
    if len(hidden) < len(old) or any(
        new < one for new, one in zip(hidden, (*old, *old[-1:] * len(hidden)), strict=False)
    ):
        raise ConfigError(
            f"hidden {'-'.join(map(str, hidden))}: the shipped policy has {'-'.join(map(str, old))}. "
            "Give as many layers or more, none narrower than its own."
        )
    larger = dataclasses.replace(sizes, hidden=hidden)
    result = {name: value.clone() for name, value in tensors.items() if not name.startswith(("actor.", "critic."))}
    generator = torch.Generator().manual_seed(0)
    for name, shape in larger.shapes().items():
        if name != "log_std":
            result[name] = 0.01 * torch.randn(shape, generator=generator)
    for part in ("actor", "critic"):
        _place(part, len(old), len(hidden), tensors, result)
    return larger, result


def _place(part: str, old: int, new: int, tensors: Mapping[str, Tensor], result: dict[str, Tensor]) -> None:
    """Put the layers of actor or critic into the larger ones, in place."""
    for index in range(old):
        weight, bias = tensors[f"{part}.{index}.weight"], tensors[f"{part}.{index}.bias"]
        _fill(result, f"{part}.{index}", weight, bias)
    width, shift = len(tensors[f"{part}.{old - 1}.bias"]), 0.0
    for index in range(old, new):
        lift = LOWEST if index == old else 0.0  # once lifted, it is positive everywhere above
        _fill(result, f"{part}.{index}", torch.eye(width), torch.full((width,), lift))
        shift += lift
    weight, bias = tensors[f"{part}.{old}.weight"], tensors[f"{part}.{old}.bias"]
    _fill(result, f"{part}.{new}", weight, bias - shift * weight.sum(1))


def _fill(result: dict[str, Tensor], layer: str, weight: Tensor, bias: Tensor) -> None:
    """The first units of a layer become these and listen to nobody else."""
    rows, columns = weight.shape
    result[f"{layer}.weight"][:rows] = 0.0
    result[f"{layer}.weight"][:rows, :columns] = weight
    result[f"{layer}.bias"][:rows] = bias
