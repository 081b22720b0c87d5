"""A terminal that is gone (a dropped ssh, a pipe whose reader ended) ends no visit: what is said then is lost."""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Iterator
from typing import Any, TextIO, cast


class StreamThatMayGo:
    """A stream until it refuses (EIO, EPIPE); from then on nothing is written, and nothing raised."""

    def __init__(self, stream: TextIO) -> None:
        self._stream, self._gone = stream, False

    def write(self, text: str) -> int:
        """As a stream's."""
        if not self._gone:
            try:
                return self._stream.write(text)
            except UnicodeEncodeError:  # a terminal that knows no such sign
                return self._stream.write(text.encode("ascii", "backslashreplace").decode())
            except OSError:
                self._let_go()
        return len(text)

    def flush(self) -> None:
        """As a stream's."""
        if not self._gone:
            try:
                self._stream.flush()
            except OSError:
                self._let_go()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def _let_go(self) -> None:
        """What the stream still holds goes nowhere: at its end Python would fail to write it, and change the exit
        code."""
        self._gone = True
        with contextlib.suppress(OSError, ValueError):  # ValueError: no stream of a file
            nowhere = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nowhere, self._stream.fileno())
            os.close(nowhere)


@contextlib.contextmanager
def that_may_go() -> Iterator[None]:
    """Inside, stdout and stderr may go."""
    before = sys.stdout, sys.stderr
    sys.stdout, sys.stderr = (None if one is None else cast("TextIO", StreamThatMayGo(one)) for one in before)  # type: ignore[assignment]
    try:
        yield
    finally:
        sys.stdout, sys.stderr = before
