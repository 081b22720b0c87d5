"""Checkpoints in the middle of a fine-tuning, by `torchrl.checkpoint`: one file, written in one move, no pickle."""

from __future__ import annotations

import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from torchrl.checkpoint import Checkpoint, CheckpointError

from hts.errors import PolicyError


class _Holder:
    """Something with a state dict, as `torchrl.checkpoint` wants it."""

    def __init__(self, state: Mapping[str, Any] | None = None):
        self.state = state

    def state_dict(self) -> Mapping[str, Any]:
        assert self.state is not None
        return self.state

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        self.state = state


def save_checkpoint(path: Path, state: Mapping[str, Any], metadata: Mapping[str, Any]) -> None:
    """Write a nested mapping of tensors; metadata: JSON values that say what it belongs to."""
    Checkpoint(format="archive", training=_Holder(state)).save(path, metadata=dict(metadata))


def load_checkpoint(path: Path, metadata: Mapping[str, Any]) -> Mapping[str, Any]:
    """Read it back. Raises PolicyError if the file is damaged or belongs to something else."""
    holder = _Holder()
    remedy = "Delete it and resume: the fine-tuning of this iteration starts again, nothing else is lost."
    try:
        found = Checkpoint.manifest(path).get("metadata", {})
        for key, expected in metadata.items():
            if found.get(key) != expected:
                raise PolicyError(f"{path}: a checkpoint of {key} {found.get(key)!r}, this run has {expected!r}. {remedy}")
        Checkpoint(format="archive", training=holder).load(path)
    except (CheckpointError, zipfile.BadZipFile, OSError, ValueError, KeyError, RuntimeError) as error:
        raise PolicyError(f"{path}: not a whole checkpoint ({type(error).__name__}: {str(error)[:100]}). {remedy}") from error
    assert holder.state is not None
    return holder.state
