"""Standard output: its faults are told as its own, not as those of a disk, a world or a model that is at work then."""

from __future__ import annotations

import codecs
import contextlib
import errno
import io
import os
import sys
from collections.abc import Iterator
from typing import Any

from hts.errors import RunError
from hts.places import place_fault

NAME = "standard output"


class OutputFault(RunError):
    """It cannot be written. No OSError, for which a plugin that reports its progress just then would be blamed."""


class NobodyReads(OutputFault):
    """Who read it is gone, as after `| head`. Of a BrokenPipeError rich and typer would end the process."""


@contextlib.contextmanager
def careful_output() -> Iterator[None]:
    """Inside, standard output names itself in errors, and what its encoding lacks is printed as an escape.

    Raises OutputFault for what could not be printed; then nothing more is.
    """
    before = sys.stdout
    if before is not sys.__stdout__ or not isinstance(before, io.TextIOWrapper):  # somebody else reads it, or nobody
        yield
        return
    before.flush()
    codecs.register_error("hts.escaped", _escaped)
    sys.stdout = io.TextIOWrapper(
        io.BufferedWriter(_Output(before.fileno(), "wb", closefd=False)),
        encoding=before.encoding,
        errors="hts.escaped" if before.errors in ("strict", "surrogateescape") else before.errors,
        line_buffering=before.line_buffering,
        write_through=before.write_through,
    )
    try:
        yield
        sys.stdout.flush()
    finally:
        sys.stdout = before


class _Output(io.FileIO):
    def write(self, data: Any) -> int:
        try:
            return super().write(data)
        except OSError as error:
            with open(os.devnull, "wb") as nothing:  # for what is still in buffers, or would be said on the way out
                os.dup2(nothing.fileno(), self.fileno())
            if error.errno == errno.EIO:  # the terminal is gone, and whoever let it go on without one wants it to
                return len(data)
            if error.errno == errno.EPIPE:
                raise NobodyReads(
                    f"{NAME}: nobody reads it any more. Write it to a file, such as with `> FILE`."
                ) from error
            raise OutputFault(f"{NAME}: {place_fault(error.errno or 0) or error.strerror}.") from error


def say_last(line: str) -> None:
    """A line on standard error, with which a command ends: where that cannot be written, nobody can be told."""
    with contextlib.suppress(OSError):
        print(line, file=sys.stderr, flush=True)


def _escaped(error: UnicodeError) -> tuple[str | bytes, int]:
    """Bytes of a file's name that are no text as they are, anything else as \\x escapes."""
    try:
        return codecs.lookup_error("surrogateescape")(error)
    except UnicodeError:
        return codecs.backslashreplace_errors(error)
