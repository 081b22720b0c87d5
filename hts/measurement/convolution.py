"""A convolution as slices and one matrix product, so that a file of operations needs no convolution.

A convolution of a reader's torch may set aside much more memory than what it gives holds, which a walk without memory
does not see; slices, a stack and a product set aside what they give.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from typing import Any

import torch
from torch import Tensor

AsOperations = Callable[..., Any]


def as_products(
    inputs: Tensor,
    weight: Tensor,
    bias: Tensor | None,
    stride: Sequence[int],
    padding: Sequence[int],
    dilation: Sequence[int],
    transposed: bool,
    output_padding: Sequence[int],
    groups: int,
) -> Any:
    """aten.convolution: inputs (W, C, *size), weight (O, C / groups, *kernel), bias (O,) -> (W, O, *size after).

    NotImplemented for a transposed one, which then stays what it is.

        y[w, o, i] = b[o] + Σ_c Σ_k weight[o, c, k] · x[w, c, stride · i + dilation · k − padding]
    """
    if transposed:
        return NotImplemented
    kernel = weight.shape[2:]
    ends = [side for one in reversed(padding) for side in (one, one)]  # the last dimension's first
    padded = torch.constant_pad_nd(inputs, ends) if any(ends) else inputs
    reach = [d * (k - 1) for d, k in zip(dilation, kernel, strict=True)]
    after = [(n - r - 1) // s + 1 for n, r, s in zip(padded.shape[2:], reach, stride, strict=True)]
    windows = []
    for place in itertools.product(*map(range, kernel)):
        window = padded
        for axis, (k, d, s, n) in enumerate(zip(place, dilation, stride, after, strict=True)):
            window = torch.ops.aten.slice.Tensor(window, axis + 2, k * d, k * d + s * (n - 1) + 1, s)
        windows.append(window)
    worlds = inputs.shape[0]  # len() would make a plain number of it, and the file one of so many worlds
    count, outputs, per_group = math.prod(after), weight.shape[0], weight.shape[1] * len(windows)
    rows = torch.stack(windows, 2).reshape(worlds, groups, per_group, count)  # (W, G, C / G · K, N)
    rows = rows.permute(1, 0, 3, 2).reshape(groups, worlds * count, per_group)
    mixed = torch.bmm(rows, weight.reshape(groups, outputs // groups, per_group).permute(0, 2, 1))  # (G, W · N, O / G)
    found = mixed.reshape(groups, worlds, count, outputs // groups).permute(1, 0, 3, 2)
    found = found.reshape(worlds, outputs, *after)
    return found if bias is None else found + bias.reshape(-1, *(1,) * len(after))


def decompositions() -> dict[Any, AsOperations]:
    """What `torch.export` writes core operations down as, and a convolution as products."""
    return {**torch.export.default_decompositions(), torch.ops.aten.convolution.default: as_products}
