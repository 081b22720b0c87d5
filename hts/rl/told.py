"""Warnings that have the place of whoever called, past the frames of this package and of torch's libraries."""

from __future__ import annotations

import inspect
import os
import warnings
from pathlib import Path

import tensordict
import torch
import torchrl

LIBRARIES = tuple(
    f"{folder}{os.sep}"
    for folder in (
        Path(__file__).parents[1],
        *(Path(str(library.__file__)).parent for library in (torch, tensordict, torchrl)),
    )
)
"""Folders whose lines no reader of a warning has written."""


def tell(message: str) -> None:
    """Give a UserWarning whose file and line are those of the call into these libraries."""
    frame, level = inspect.currentframe(), 1
    while frame is not None and frame.f_code.co_filename.startswith(LIBRARIES):
        frame, level = frame.f_back, level + 1
    warnings.warn(message, stacklevel=level)
