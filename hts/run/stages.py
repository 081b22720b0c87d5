"""Stages of a run: each does one thing once, and its result file is the proof that it is done."""

from __future__ import annotations

import errno
import json
import math
import os
import time
from collections.abc import Callable
from functools import cached_property
from pathlib import Path
from typing import IO, Any

from pydantic import TypeAdapter, ValidationError

from hts.atomic import atomic_write
from hts.errors import RunError
from hts.locks import take_lock
from hts.run.progress import Progress

TIMES = "log/stages.json"
LAST = ("summary.json", "report.html")
"""What a run writes last."""
UNWRITABLE = (errno.EROFS, errno.EACCES, errno.EPERM)

Report = Callable[[float], None]
"""Takes the share of a stage that is done, 0 to 1."""

ENDED_EARLY = "iterations.json"
"""In a run's folder where real samples ended the iterations before the last one: {"done", "of"}."""


def write_json(path: Path, value: Any) -> None:
    """`atomic_write` of a JSON value, infinity and NaN as null. Raises OSError naming the file if the disk refuses."""
    atomic_write(path, json.dumps(_finite(value), indent=1, allow_nan=False) + "\n")


def read_json(path: Path) -> Any:
    """Raises RunError for a file that is damaged."""
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        raise RunError(
            f"{path}: missing. Expected the JSON of a finished stage. Resume: that stage runs again."
        ) from error
    except (json.JSONDecodeError, UnicodeDecodeError) as error:
        raise damaged(path, str(error)) from error


def damaged(path: Path, why: str) -> RunError:
    """The error for a stage's file that a run cannot go on with."""
    return RunError(
        f"{path}: damaged ({why}). Expected the JSON of a finished stage. Delete it and resume: that stage runs again."
    )


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(key): _finite(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def number(value: float | None, otherwise: float = math.nan) -> float:
    """What `write_json` wrote as null, having neither NaN nor infinity, as the one that it was."""
    return otherwise if value is None else float(value)


class Stages:
    """The stages of one run folder. `do` skips what is done, so that a run killed anywhere goes on by calling it again.

    Only one process may work in a folder: RunError if another one does. A finished run that cannot be written to, as on
    a read-only medium, is only read, and needs no lock. read: of the file of a stage that is done; raises RunError for
    one that nothing can be made of.
    """

    def __init__(self, folder: Path, progress: Progress, read: Callable[[Path], Any] = read_json) -> None:
        self.folder, self.progress, self._read = folder, progress, read
        try:
            self._lock: IO[str] | None = (folder / ".lock").open("w")
        except OSError as error:
            if error.errno not in UNWRITABLE or not all((folder / name).is_file() for name in LAST):
                raise
            self._lock = None
            return
        if not take_lock(self._lock):
            self._lock.close()
            raise RunError(f"{folder}: another process is working in it. Wait for it, or stop it first.")
        self._files = [entry.name for entry in folder.iterdir() if entry.is_file()]

    def do(self, name: str, title: str, work: Callable[[Report], Any]) -> Any:
        """Result of a stage: from `name`.json if it is done, else of work(report), stored there.

        What `work` leaves behind beside its result must be harmless to write twice.
        """
        path = self.folder / f"{name}.json"
        if path.exists():
            self.progress.skip(1)
            return self._read(path)
        self.check_there()
        started = time.perf_counter()
        with self.progress.stage(title) as report:
            result = work(report)
        self.check_there()
        write_json(path, result)
        self._times[name] = round(time.perf_counter() - started, 3)
        write_json(self.folder / TIMES, self._times)
        return read_json(path)

    def check_there(self, cause: Exception | None = None) -> None:
        """Raise RunError if the folder is not under its name any more: what is written there would make another one.

        cause: what went wrong, which may come of that.
        """
        if self._is_gone():
            raise RunError(
                f"{self.folder}: was moved, renamed or deleted while the run worked in it. Resume it where it lies now "
                "(`hts resume DIR`), and delete what was written under the old name since, if anything is there."
            ) from cause

    def _is_gone(self) -> bool:
        if self._lock is None:
            return False
        try:
            return not os.path.samestat(os.fstat(self._lock.fileno()), os.stat(self.folder / ".lock"))
        except (FileNotFoundError, NotADirectoryError):  # of the lock alone, somebody may have thought that it is left
            return not any((self.folder / name).exists() for name in self._files)

    def seconds(self) -> dict[str, float]:
        """How long each finished stage took, s; only those since, where the file of them was damaged."""
        return dict(self._times)

    @cached_property
    def _times(self) -> dict[str, float]:
        path = self.folder / TIMES
        if not path.exists():
            return {}
        try:
            return TypeAdapter(dict[str, float]).validate_python(read_json(path), strict=True)
        except (RunError, ValidationError):
            self.progress.say(f"{path}: damaged. It says only how long stages took: those of before are not counted.")
            return {}

    def close(self) -> None:
        if self._lock is not None:
            self._lock.close()
