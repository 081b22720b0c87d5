"""The operator's key: Enter on the terminal, a file called STOP in the bundle, a signal (Ctrl-C, SIGTERM, SIGUSR1)."""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import IO

Brake = Callable[[str, str], None]
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGUSR1)


class StopFile:
    """Pressed while the file is there."""

    def __init__(self, path: Path) -> None:
        self._path, self._shown = os.fspath(path), path.name

    def __call__(self) -> str | None:
        return f"the file {self._shown} is there" if os.path.exists(self._path) else None


@contextlib.contextmanager
def signals(brake: Brake) -> Iterator[None]:
    """While inside, signals brake the robot instead of ending the process."""

    def pressed(number: int, frame: object) -> None:
        brake("operator", f"signal {signal.Signals(number).name}")

    before = {one: signal.signal(one, pressed) for one in SIGNALS}
    try:
        yield
    finally:
        for one, handler in before.items():
            signal.signal(one, handler)


def listen(brake: Brake, keys: IO[str] | None = None) -> None:
    """A thread brakes the robot as soon as a line comes from stdin (or `keys`). An end of it is no key."""
    stream = sys.stdin if keys is None else keys

    def work() -> None:
        if stream.readline():
            brake("operator", "a key on the terminal")

    threading.Thread(target=work, daemon=True).start()
