"""What the classes of `hts.rl` are given, looked at where it is given: numbers, and states that were saved."""

from __future__ import annotations

from collections.abc import Mapping
from numbers import Real
from typing import Any

import torch
from torch import nn


def check_number(name: str, given: Any, expected: str) -> None:
    """Raise TypeError unless given is a number, or a tensor with one; expected: what it says, in words."""
    if not isinstance(given, Real) and not (isinstance(given, torch.Tensor) and given.numel() == 1):
        raise TypeError(f"{name} is {given!r}, a {type(given).__name__}; expected a number: {expected}.")


def as_numbers(name: str, given: Any, expected: str, device: torch.device | None = None) -> torch.Tensor:
    """given as a tensor. Raises TypeError for what is none, such as a text; expected: what it is to be, in words."""
    try:
        return torch.as_tensor(given, dtype=torch.get_default_dtype(), device=device)
    except (TypeError, ValueError, RuntimeError) as error:  # which of them, torch has no rule for
        raise TypeError(f"{name} is {given!r}; expected {expected}.") from error


class OfItsSizes(nn.Module):
    """A module that refuses a saved state of other sizes in one line: torch has one for each tensor."""

    def _load_from_state_dict(self, state_dict: Mapping[str, Any], prefix: str, *how: Any) -> None:
        for name, own in self.state_dict().items():
            found = state_dict.get(prefix + name)
            if not isinstance(found, torch.Tensor) or found.shape == own.shape:
                continue
            if own.ndim == 0 and found.shape == (1,):  # of one candidate: torch takes it
                continue
            raise ValueError(
                f"{type(self).__name__}: '{name}' of the saved state has the shape {tuple(found.shape)}, expected "
                f"{tuple(own.shape)}: it was saved from one of other sizes, or of another number of candidates. Make "
                "this one as that was, or load another state."
            )
        super()._load_from_state_dict(state_dict, prefix, *how)
