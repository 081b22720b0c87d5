"""SIGTERM and SIGHUP end what can be gone on with like Ctrl-C does: with a line, and with what was begun taken away."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from types import FrameType
from typing import Any

ENDS = (signal.SIGTERM, signal.SIGHUP)
"""Of a batch system, a shutdown or `kill`; of a terminal that was closed."""

Handler = Callable[[int, FrameType | None], Any] | int | signal.Handlers | None


class ToldToEnd(KeyboardInterrupt):
    """One of these signals came."""

    def __init__(self, number: int) -> None:
        super().__init__()
        self.name, self.exit_code = signal.Signals(number).name, 128 + number


@contextmanager
def told_to_end() -> Iterator[None]:
    """Inside, these signals raise ToldToEnd; a second one ends the process at once. One that is ignored, as after
    `nohup`, stays so. See `_leaving`, which is also done for Ctrl-C."""
    with interruptible(), _leaving(ENDS, signal.SIG_DFL, ToldToEnd):
        yield


@contextmanager
def interruptible() -> Iterator[None]:
    """Inside, Ctrl-C leaves as KeyboardInterrupt whatever a library makes of it. A second one is one as well."""
    with _leaving([signal.SIGINT], signal.default_int_handler, lambda number: KeyboardInterrupt()):
        yield


@contextmanager
def _leaving(numbers: Sequence[int], usual: Handler, made: Callable[[int], KeyboardInterrupt]) -> Iterator[None]:
    """Inside, what is `made` of these signals is raised. Once one came, any error leaves as that: a library written in
    C that is interrupted while it is imported makes an ImportError of it. usual: what a signal that nobody else has
    taken meets, and a second one."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    end = _End(usual, made)
    before = {number: signal.getsignal(number) for number in numbers}
    ours = {number: handler for number, handler in before.items() if handler is usual or isinstance(handler, _End)}
    for number in ours:
        signal.signal(number, end)
    try:
        yield
    except Exception as error:
        if end.came:
            raise end.came[0] from error
        raise
    finally:
        for number, handler in ours.items():
            signal.signal(number, handler)


class _End:
    """A handler that notes and raises what is made of a signal, and hears of the first one only."""

    def __init__(self, usual: Handler, made: Callable[[int], KeyboardInterrupt]) -> None:
        self.came: list[KeyboardInterrupt] = []
        self._usual, self._made = usual, made

    def __call__(self, number: int, frame: FrameType | None) -> None:
        signal.signal(number, self._usual)
        self.came.append(self._made(number))
        raise self.came[-1]
