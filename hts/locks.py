"""A lock on an open file or folder. The kernel drops it when the process that holds it ends, however it ends."""

from __future__ import annotations

import errno
import fcntl
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

from hts.errors import RunError

NO_LOCKS = (errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP, errno.EINVAL, errno.EBADF)
"""What file systems answer that know no locks, or none on what is open for reading alone."""


def take_lock(handle: IO[Any] | int, *, wait: bool = False) -> bool:
    """Whether the lock is ours now; False: another process holds it. wait: until it does not.

    Where the file system knows no locks, nobody else holds one: True. Raises OSError for a fault.
    """
    try:
        fcntl.flock(handle, fcntl.LOCK_EX if wait else fcntl.LOCK_EX | fcntl.LOCK_NB)
    except (BlockingIOError, PermissionError):  # CIFS says EACCES (flock(2))
        return False
    except OSError as error:
        if error.errno not in NO_LOCKS:
            raise
    return True


@contextmanager
def only_one(lock: Path, otherwise: str) -> Iterator[None]:
    """Nobody else is inside with the same lock file, which is made and stays. Raises RunError, `otherwise`, where
    somebody is."""
    with lock.open("w") as handle:
        if not take_lock(handle):
            raise RunError(otherwise)
        yield
