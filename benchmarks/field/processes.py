"""Processes that end with the one that started them, and that are killed with all that they started."""

from __future__ import annotations

import contextlib
import ctypes
import os
import signal
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import IO, Any

DIE_WITH_PARENT = 1  # PR_SET_PDEATHSIG of Linux


def start(command: Sequence[str], output: int | IO[Any] | None, errors: int | IO[Any] | None) -> subprocess.Popen[str]:
    """`python ARGUMENTS` in a process group of its own."""
    return subprocess.Popen(
        [sys.executable, *command],
        stdout=output,
        stderr=errors,
        stdin=subprocess.DEVNULL,
        text=True,
        env={**os.environ, "PYTHONUNBUFFERED": "1", "COLUMNS": "200"},
        start_new_session=True,
        preexec_fn=_with_parent if sys.platform == "linux" else None,  # noqa: PLW1509 - two system calls, no locks
    )


def kill(process: subprocess.Popen[str]) -> None:
    """SIGKILL to the process group, and wait."""
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    if process.stdout is not None:
        process.stdout.close()


def tail(path: Path, lines: int = 3) -> str:
    """The last lines of a file."""
    with contextlib.suppress(OSError):
        return "\n".join(path.read_text(errors="replace").strip().splitlines()[-lines:])
    return ""


def _with_parent() -> None:
    """Whoever started it may be killed: then nothing goes on that a second start would meet."""
    ctypes.CDLL(None).prctl(DIE_WITH_PARENT, signal.SIGKILL)
