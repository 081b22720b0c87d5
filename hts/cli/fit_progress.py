"""How far a fit is, on stderr: at once on a terminal, every ten seconds in a file; nothing of a fit that is quick."""

from __future__ import annotations

import sys
import time
from types import TracebackType
from typing import Self

QUIET_SECONDS = 2.0
IN_A_FILE_SECONDS = 10.0
ON_A_TERMINAL_SECONDS = 0.2


class FitProgress:
    """Called with (epoch, epochs, error) as a model learns; `say` names what is being done."""

    def __init__(self) -> None:
        self._began = self._last = time.monotonic()
        self._doing, self._terminal, self._shown = "fitting", sys.stderr.isatty(), False

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._terminal and self._shown:
            print("\r\x1b[K", end="", file=sys.stderr, flush=True)

    def say(self, text: str) -> None:
        """What is being done now."""
        self._doing = text
        self._show(text)

    def __call__(self, epoch: int, epochs: int, error: float) -> None:
        part = f", epoch {epoch} of {epochs}" if epochs > 1 else ""
        self._show(f"{self._doing}{part}: 1 − R² {error:.3f}")

    def _show(self, text: str) -> None:
        now = time.monotonic()
        pause = ON_A_TERMINAL_SECONDS if self._terminal else IN_A_FILE_SECONDS
        if now - self._began < QUIET_SECONDS or now - self._last < pause:
            return
        self._last, self._shown = now, True
        line = f"{text} ({now - self._began:.0f} s)"
        print(f"\r\x1b[K{line}" if self._terminal else line, end="" if self._terminal else "\n", file=sys.stderr)
        sys.stderr.flush()
