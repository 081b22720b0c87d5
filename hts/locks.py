"""A lock on an open file or folder. The kernel drops it when the process that holds it ends, however it ends."""

from __future__ import annotations

import fcntl
from typing import IO, Any


def take_lock(handle: IO[Any] | int, *, wait: bool = False) -> bool:
    """Whether the lock is ours now; False: another process holds it. wait: until it does not.

    Where the file system knows no locks, nobody else holds one: True.
    """
    try:
        fcntl.flock(handle, fcntl.LOCK_EX if wait else fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        return True
    return True
