"""Which steps of a batch count: TorchRL marks with masks those that it has filled stretches up with."""

from __future__ import annotations

from collections.abc import Iterable

import torch
from tensordict import TensorDictBase
from tensordict.utils import NestedKey
from torchrl.objectives.common import AUTO_LOSS_MASK_KEYS

from hts.rl.kl import expands


def marks_in(batch: TensorDictBase, keys: Iterable[NestedKey] = AUTO_LOSS_MASK_KEYS) -> list[NestedKey]:
    """Those of the keys that the batch has a mask under; to look once for what is asked several times."""
    return [key for key in keys if batch.get(key, None) is not None]


def counted(
    batch: TensorDictBase, shape: torch.Size, keys: Iterable[NestedKey] = AUTO_LOSS_MASK_KEYS
) -> torch.Tensor | None:
    """True where a number of this shape is of a step that counts; None: all of them do.

    keys: of the masks, bool, of the batch's shape with or without a dimension of one behind it; those that the batch
    has hold together. Raises ValueError for one of another shape, and, on a CPU, where no step counts.
    """
    marks = marks_in(batch, keys)
    if not marks:
        return None
    mask = torch.stack([_expanded(key, batch[key], shape) for key in marks]).all(0)
    if mask.device.type == "cpu" and not torch.compiler.is_compiling() and not bool(mask.any()):
        names = " and ".join(map(repr, marks))
        raise ValueError(
            f"{names} leave no step of the batch {tuple(batch.shape)} over; expected one at least. Leave it out."
        )
    return mask


def _expanded(key: NestedKey, mask: torch.Tensor, shape: torch.Size) -> torch.Tensor:
    own = mask
    while own.ndim > len(shape) and own.shape[-1] == 1:
        own = own.squeeze(-1)
    own = own.reshape(*own.shape, *(1,) * (len(shape) - own.ndim))
    if mask.dtype != torch.bool or not expands(own.shape, shape):
        raise ValueError(
            f"The mask {key!r} is {tuple(mask.shape)} of {mask.dtype}, what it is to mark {tuple(shape)}; expected "
            "torch.bool, one for each step. loss.loss_mask_key names another one, None counts every step."
        )
    return own.expand(shape)
