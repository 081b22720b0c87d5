"""Processes that end with the one that started them, and that are killed with all that they started."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import IO, Any

WITH_PARENT = Path(__file__).with_name("with_parent.py")
Output = int | IO[Any] | None


def start(
    module: str, arguments: Sequence[str], output: Output, errors: Output, **variables: str
) -> subprocess.Popen[str]:
    """`python -m MODULE ARGUMENTS` in a process group of its own. variables: of its environment."""
    return subprocess.Popen(
        [sys.executable, str(WITH_PARENT), str(os.getpid()), module, *arguments],
        stdout=output,
        stderr=errors,
        stdin=subprocess.DEVNULL,
        text=True,
        env={**os.environ, "PYTHONUNBUFFERED": "1", "COLUMNS": "200", **variables},
        start_new_session=True,
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
