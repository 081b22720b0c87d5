"""Files that appear whole or not at all: every result, card and model that hts writes goes through here."""

from __future__ import annotations

import contextlib
import errno
import os
from pathlib import Path


def temporary_of(path: Path) -> Path:
    """Where `path` is written before it appears. One name for each file: what a killed writer left,
    the next one overwrites."""
    return path.with_name(f".{path.name}.tmp")


def atomic_write(path: Path, content: bytes | str, *, temporary: Path | None = None) -> Path:
    """Write `path` (text as UTF-8) in one move, on the disk when this returns; makes its folder. Returns `path`.

    A reader sees the old file or the new one, never half of one. temporary: where it is written first, in the same file
    system; writers that may be at it at the same moment need one each. Raises OSError that names `path`, and leaves
    nothing behind.
    """
    data = content.encode("utf-8") if isinstance(content, str) else content
    part = temporary or temporary_of(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with part.open("wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        os.replace(part, path)
        sync(path.parent)
    except OSError as error:
        with contextlib.suppress(OSError):  # why nothing was written matters more than what may be left of it
            part.unlink(missing_ok=True)
        raise OSError(error.errno, error.strerror, str(path)) from error
    return path


UNABLE = (errno.EINVAL, errno.ENOSYS, errno.EOPNOTSUPP)
"""What file systems answer that cannot sync a folder."""


def sync(path: Path) -> None:
    """What is known of a file is on the disk, or of a folder, where its file system can do that. Raises OSError."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    except OSError as error:
        if error.errno not in UNABLE or not path.is_dir():
            raise
    finally:
        os.close(handle)
