"""SIGTERM and SIGHUP end what can be gone on with like Ctrl-C does: with a line, and with what was begun taken away."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

ENDS = (signal.SIGTERM, signal.SIGHUP)
"""Of a batch system, a shutdown or `kill`; of a terminal that was closed."""


class ToldToEnd(KeyboardInterrupt):
    """One of these signals came."""

    def __init__(self, number: int) -> None:
        super().__init__()
        self.name, self.exit_code = signal.Signals(number).name, 128 + number


@contextmanager
def told_to_end() -> Iterator[None]:
    """Inside, these signals raise ToldToEnd; a second one ends the process at once. One that is ignored, as after
    `nohup`, stays so. Once one came, any error leaves as ToldToEnd: a library written in C that is interrupted while it
    is imported makes an ImportError of it."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    came: list[ToldToEnd] = []

    def end(number: int, frame: FrameType | None) -> None:
        signal.signal(number, signal.SIG_DFL)
        came.append(ToldToEnd(number))
        raise came[0]

    ours = [number for number in ENDS if signal.getsignal(number) is signal.SIG_DFL]
    for number in ours:
        signal.signal(number, end)
    try:
        yield
    except Exception as error:
        if came:
            raise came[0] from error
        raise
    finally:
        for number in ours:
            signal.signal(number, signal.SIG_DFL)
