"""The operator's keys. To stop at once: Enter or Ctrl-D on the terminal, a file called STOP in the bundle, or any of
SIGNALS: Ctrl-C, Ctrl-\\ and Ctrl-Z on the terminal, its end (a dropped ssh, also under nohup), SIGTERM, SIGUSR1. To sit
down: `rest`."""

from __future__ import annotations

import contextlib
import os
import select
import signal
import sys
import termios
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import IO

from hts_go1_runtime.errors import RuntimeFault
from hts_go1_runtime.rest import KEY

GLANCE = 0.1  # s: how often a question looks at whatever else could end the waiting
ENDED = 1.0  # s: an input (no terminal) that ends so soon, as /dev/null or `echo |` does, never had anybody at it
Brake = Callable[[str, str], None]
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGUSR1, signal.SIGHUP, signal.SIGQUIT, signal.SIGTSTP)
KEY_GONE = (
    "the key Enter is gone, the input has ended: a file STOP in the bundle, Ctrl-C or SIGTERM stop the robot, a file "
    "SIT lets it sit down"
)


class StopFile:
    """Pressed while the file is there."""

    def __init__(self, path: Path) -> None:
        self._path, self._shown = os.fspath(path), path.name

    def __call__(self) -> str | None:
        return f"the file {self._shown} is there" if os.path.exists(self._path) else None


@contextlib.contextmanager
def signals(brake: Brake) -> Iterator[None]:
    """While inside, signals brake the robot instead of ending the process."""

    with handled(lambda number, frame: brake("operator", f"signal {signal.Signals(number).name}")):
        yield


@contextlib.contextmanager
def handled(handler: Callable[[int, object], None]) -> Iterator[None]:
    """While inside, this is done at any of SIGNALS, and nothing else. In the main thread alone."""
    before = {one: signal.signal(one, handler) for one in SIGNALS}
    try:
        yield
    finally:
        for one, was in before.items():
            signal.signal(one, was)


def listen(
    brake: Brake,
    keys: IO[str] | None = None,
    gone: Callable[[str], None] = lambda line: None,
    rest: Callable[[str], None] | None = None,
    steering: Mapping[str, Callable[[], None]] | None = None,
) -> None:
    """A thread brakes the robot as soon as a line comes from stdin (or `keys`), or that ends: a terminal at any time
    (Ctrl-D, or it is gone), another input once somebody could have typed there (an `ssh` without a terminal that
    dropped). gone: told in a line where there is no key from the beginning; rest: told of a line that is `rest.KEY`
    alone, which brakes nobody; steering: what is done at other lines that brake nobody."""
    stream = sys.stdin if keys is None else keys
    if stream is None:
        gone(KEY_GONE)
        return
    terminal, began = stream.isatty(), time.monotonic()
    harmless = {**(steering or {}), **({} if rest is None else {KEY: lambda: rest(f"the key {KEY}")})}

    def work() -> None:
        try:
            line = stream.readline()
            while (typed := line.strip().lower()) in harmless:
                harmless[typed]()
                line = stream.readline()
            key = "a key on the terminal" if line else ""
        except OSError:  # a terminal that is gone
            key = ""
        if key or terminal or time.monotonic() - began > ENDED:
            brake("operator", key or f"the end of the input{' on the terminal' if terminal else ''}")
        else:
            gone(KEY_GONE)

    threading.Thread(target=work, daemon=True).start()


def ask(question: str, look: Callable[[], None], keys: IO[str] | None = None) -> None:
    """Wait until somebody answers a question by Enter alone on stdin (or `keys`).

    A key that was pressed before the question was shown is no answer to it: a terminal forgets such. look: asked while
    it waits; what it raises ends the waiting. (A read that blocks would hide a signal: Python begins it anew.)

    Raises RuntimeFault for any other answer, and where nobody can answer.
    """
    stream = sys.stdin if keys is None else keys
    if stream is None:
        raise RuntimeFault(_NOBODY)
    handle, line = stream.fileno(), b""
    if os.isatty(handle):
        termios.tcflush(handle, termios.TCIFLUSH)
    print(question, flush=True)
    while not line.endswith(b"\n"):
        look()
        if select.select([handle], [], [], GLANCE)[0]:
            sign = b""
            with contextlib.suppress(OSError):  # a terminal that is gone
                sign = os.read(handle, 1)
            if not sign:
                raise RuntimeFault(_NOBODY)
            line += sign
    if line.strip(b"\r\n"):
        said = line.decode(errors="replace").strip("\r\n")[:40]
        raise RuntimeFault(
            f"'{said}' was typed, and Enter alone begins. Nothing has moved; start again when all is clear."
        )


_NOBODY = "Nobody said that the robot may move. Start it from a terminal, or with --yes."
