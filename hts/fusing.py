"""torch.compile where it pays and can work: several small operations on a GPU as one pass over memory."""

from __future__ import annotations

import importlib.util
import os
import shutil
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, TypeVar

if TYPE_CHECKING:
    import torch

Function = TypeVar("Function", bound=Callable[..., Any])


def can_fuse(device: torch.device) -> bool:
    """Whether torch.compile has what it needs: a GPU, Triton, and a C compiler for its launchers."""
    compiler = os.environ.get("CC") or shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
    return device.type == "cuda" and compiler is not None and importlib.util.find_spec("triton") is not None


def fused(function: Function, device: torch.device, wanted: bool | None = None, dynamic: bool = False) -> Function:
    """function, compiled; itself where that cannot be. wanted: None decides by `can_fuse`; dynamic: once for all shapes,
    otherwise anew for each."""
    if not (can_fuse(device) if wanted is None else wanted):
        return function
    import torch

    return torch.compile(function, dynamic=dynamic)  # type: ignore[return-value]
