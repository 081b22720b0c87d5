"""One runtime at a time on a bundle, which would be written twice, and with a robot, which would be told two things."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
import socket
import sys
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


def alone_with(url: str, peer: tuple[object, ...]) -> socket.socket | None:
    """As long as what this gives is open, and this process lives, nobody else of this computer has it for this robot.
    peer: its address and port; None where the system has no names for that.

    Raises RuntimeFault if somebody has it: two bundles are two folders of logs, but one robot.
    """
    if sys.platform != "linux":
        return None
    name = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    try:
        name.bind(f"\0hts_go1_runtime {peer[0]} {peer[1]}")  # a name in no folder: it goes with the process
    except OSError as error:
        name.close()
        if error.errno != errno.EADDRINUSE:
            return None
        raise RuntimeFault(
            f"--link {url}: another runtime of this computer talks to this robot, which would be told two things. Wait "
            "until it has ended, or end it."
        ) from error
    return name
