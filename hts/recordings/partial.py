"""Folders under construction: locked while their writer lives, recognisable as rubbish once it is dead.

A writer builds `.partial-<random>` inside the store, holding `flock` on that folder, and renames it when it is
complete. The kernel drops the lock when the process ends, however it ends, so a cleaner that gets the lock
knows that nobody will finish the folder. One rename makes a recording visible: before it there is nothing,
after it everything.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
import secrets
import shutil
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from hts.atomic import atomic_write, sync
from hts.locks import take_lock

PREFIX = ".partial-"


@contextlib.contextmanager
def partial_folder(store: Path) -> Iterator[Path]:
    """A new locked folder inside the store, removed on leaving unless it was renamed away. Raises OSError."""
    folder, handle = _make_locked(store)
    try:
        yield folder
    finally:
        # Whatever went wrong matters more than a leftover, which the next writer removes.
        shutil.rmtree(folder, ignore_errors=True)
        os.close(handle)


def publish(folder: Path, final: Path) -> bool:
    """Flush a finished folder to the disk and make it visible in one rename.

    Returns False, changing nothing, if `final` is there already. Raises OSError.
    """
    paths = [
        Path(path)
        for parent, _, files in os.walk(folder)
        for path in (parent, *(os.path.join(parent, f) for f in files))
    ]
    with ThreadPoolExecutor(max_workers=8) as pool:  # waiting disks can wait for many files at once
        list(pool.map(sync, paths))
    try:
        os.rename(folder, final)
    except OSError as error:
        if error.errno in (errno.ENOTEMPTY, errno.EEXIST):
            return False
        raise
    sync(final.parent)
    return True


def publish_file(text: str, final: Path) -> None:
    """Write a small file so that it is never seen half-written. Raises OSError."""
    with partial_folder(final.parent) as folder:  # several processes may be making the same store
        atomic_write(final, text, temporary=folder / final.name)


def clean(store: Path) -> int:
    """Remove what killed writers left behind; folders of living writers stay. Returns how many went."""
    removed = 0
    for folder in sorted(store.glob(PREFIX + "*")):
        try:
            handle = os.open(folder, os.O_RDONLY)
        except FileNotFoundError:  # finished or cleaned by somebody else just now
            continue
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:  # its writer is alive, or this file system knows no locks and nobody can tell
            continue
        else:
            shutil.rmtree(folder, ignore_errors=True)
            removed += 1
        finally:
            os.close(handle)
    return removed


def _make_locked(store: Path) -> tuple[Path, int]:
    while True:
        folder = store / (PREFIX + secrets.token_hex(8))
        os.mkdir(folder)
        # A cleaner may take a folder in the instant between making and locking it; then take another name.
        try:
            handle = os.open(folder, os.O_RDONLY)
        except FileNotFoundError:
            continue
        if take_lock(handle) and _same(handle, folder):
            return folder, handle
        os.close(handle)


def _same(handle: int, folder: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(handle), os.stat(folder))
    except FileNotFoundError:
        return False
