"""The reward of an objective, asked: one for each prediction comes back, or one line says whose mistake it is."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import torch

from hts.errors import PluginError
from hts.guarded import guarded


def reward_of(name: str, reward: Callable[[torch.Tensor], torch.Tensor], prediction: torch.Tensor) -> torch.Tensor:
    """r_real of predictions of any shape, same shape. Its numbers are not looked at: on a GPU that would wait for them.

    name: of the objective. Raises PluginError for an exception in its reward, another shape, whole numbers, no tensor.
    """
    what = f"Objective '{name}': reward()"
    found = guarded(what, partial(reward, prediction))
    if not isinstance(found, torch.Tensor) or found.shape != prediction.shape:
        gave = f"shape {tuple(found.shape)}" if isinstance(found, torch.Tensor) else type(found).__name__
        raise PluginError(
            f"{what} gave {gave} for a prediction of shape {tuple(prediction.shape)}; expected the same shape, one "
            "reward for each prediction."
        )
    if not found.is_floating_point():
        raise PluginError(
            f"{what} gave numbers of {found.dtype}, expected {prediction.dtype}, as the prediction has: nothing "
            "between two whole numbers would count. Append .float()."
        )
    return found
