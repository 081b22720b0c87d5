"""Checkpoints in the middle of a training, by `torchrl.checkpoint`: one file, written in one move, no pickle."""

from __future__ import annotations

import errno
import os
import shutil
import zipfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import torch
from torchrl.checkpoint import Checkpoint, CheckpointError

from hts.errors import PolicyError

NOTES = "notes"
BLOCK = 4096  # bytes, of the usual file systems
MARGIN = 1 << 20  # bytes: manifest, notes and folders
REMEDY = "Delete it and resume: this training starts again, nothing else is lost."


class _Holder:
    """Something with a state dict, as `torchrl.checkpoint` wants it."""

    def __init__(self, state: Mapping[str, Any] | None = None) -> None:
        self.state = state

    def state_dict(self) -> Mapping[str, Any]:
        assert self.state is not None
        return self.state

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        self.state = state


def save_checkpoint(
    path: Path, state: Mapping[str, Any], metadata: Mapping[str, Any], notes: Mapping[str, Any] | None = None
) -> None:
    """Write a nested mapping of tensors; metadata: JSON values that say what it belongs to; notes: any others.

    Raises OSError if the disk refuses; an older checkpoint of that name is whole afterwards all the same.
    """
    _check_room(path, state)
    Checkpoint(format="archive", training=_Holder(state)).save(path, metadata={**metadata, NOTES: dict(notes or {})})


def load_checkpoint(path: Path, metadata: Mapping[str, Any]) -> Mapping[str, Any]:
    """Read it back. Raises PolicyError if the file is damaged or belongs to something else."""
    holder = _Holder()
    with _damage(path):
        found = Checkpoint.manifest(path).get("metadata", {})
        for key, expected in metadata.items():
            if found.get(key) != expected:
                raise PolicyError(
                    f"{path}: a checkpoint of {key} {found.get(key)!r}, this run has {expected!r}. {REMEDY}"
                )
        Checkpoint(format="archive", training=holder).load(path)
    assert holder.state is not None
    return holder.state


def load_notes(path: Path) -> dict[str, Any]:
    """What `save_checkpoint` was given as notes. Raises PolicyError if the file is damaged."""
    with _damage(path):
        return dict(Checkpoint.manifest(path)["metadata"][NOTES])


def _check_room(path: Path, state: Mapping[str, Any]) -> None:
    """Raises OSError (disk full) before anything is written that would not fit.

    `torchrl.checkpoint` writes tensors through memory maps, and a disk that is full then ends the process (SIGBUS)
    without a word. It writes twice: the parts, then the archive of them.
    """
    needed = 2 * _size(state) + MARGIN
    path.parent.mkdir(parents=True, exist_ok=True)
    if shutil.disk_usage(path.parent).free < needed:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path))


def _size(value: Any) -> int:
    """Bytes of all tensors in nested mappings, each rounded up to whole blocks of a disk."""
    if isinstance(value, torch.Tensor):
        return (value.numel() * value.element_size() // BLOCK + 1) * BLOCK
    return sum(_size(part) for part in value.values()) if isinstance(value, Mapping) else 0


@contextmanager
def _damage(path: Path) -> Iterator[None]:
    """Whatever a damaged archive makes the libraries say, as one line."""
    try:
        yield
    except (CheckpointError, zipfile.BadZipFile, OSError, ValueError, KeyError, RuntimeError) as error:
        what = f"{type(error).__name__}: {str(error)[:100]}"
        raise PolicyError(f"{path}: not a whole checkpoint ({what}). {REMEDY}") from error
