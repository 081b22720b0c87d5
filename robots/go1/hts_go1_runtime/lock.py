"""One runtime at a time on a bundle: two would write the same logs, and one robot would be told two things."""

from __future__ import annotations

import contextlib
import fcntl
import os
from collections.abc import Iterator
from pathlib import Path

from hts_go1_runtime.errors import RuntimeFault


@contextlib.contextmanager
def alone(logs: Path) -> Iterator[None]:
    """While inside, nobody else is inside for this folder of logs. The lock goes with the process, however it ends.

    Raises RuntimeFault if somebody is, or if the folder takes no lock.
    """
    path = logs / ".lock"
    with contextlib.ExitStack() as stack:
        try:
            logs.mkdir(parents=True, exist_ok=True)
            handle = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
            stack.callback(os.close, handle)
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise RuntimeFault(
                f"{path}: another runtime records into this bundle. Wait until it has ended, or end it."
            ) from error
        except OSError as error:
            raise RuntimeFault(
                f"{path}: cannot be made and locked ({error.strerror}). Put the bundle on a disk that can be written."
            ) from error
        yield
