"""The operator's key: Enter on this terminal, a file called STOP in the bundle, or a signal (Ctrl-C, SIGTERM, SIGUSR1)."""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

Brake = Callable[[str, str], None]
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGUSR1)


class StopFile:
    """Pressed while the file is there."""

    def __init__(self, path: Path) -> None:
        self._path, self._shown = os.fspath(path), path.name

    def __call__(self) -> str | None:
        return f"the file {self._shown} is there" if os.path.exists(self._path) else None  # noqa: PTH110 - 50 times a s


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


def listen(brake: Brake) -> None:
    """A thread brakes the robot as soon as a line comes from stdin. An end of stdin is no key."""

    def work() -> None:
        if sys.stdin.readline():
            brake("operator", "a key on the terminal")

    threading.Thread(target=work, daemon=True).start()
