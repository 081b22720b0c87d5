"""Runs side by side, each on its own cores, and one line as soon as one ends. Killed at any time, it goes on.

Everything happens in one thread: a run is told to die with the process that started it, and on Linux that is meant of
the thread that did.
"""

from __future__ import annotations

import contextlib
import ctypes
import datetime
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO

from batch.harvest import finished, provenance_of, result_of
from batch.lines import Line, Part, RunLine, append, read_lines
from batch.methods import Job
from batch.places import Places, Slot
from hts.errors import HtsError
from hts.locks import take_lock

STOPPED = 75
"""Exit status where the time is up and runs are left: call again."""
PR_SET_PDEATHSIG = 1
GRACE_SECONDS = 20.0
HTS = (sys.executable, "-m", "hts.cli.main")
RAISED = re.compile(r"[A-Za-z_][\w.]*(Error|Exception|Interrupt|Exit)\b")


@dataclass(frozen=True)
class Target:
    """Where a run's line goes, and the name of its batch there."""

    lines: Path
    batch: str


@dataclass(frozen=True)
class Kind:
    """What is made in each folder, and kept as its line.

    finished: whether nothing is left to be done there; result: what a finished folder came to, raises HtsError for one
    that is not readable; made: the lines of these files; line: makes one of a `RunLine`'s fields and the result; said:
    of a line without an error, in short.
    """

    finished: Callable[[Path], bool]
    result: Callable[[Path], Part]
    made: Callable[[Sequence[Path]], Sequence[RunLine]]
    line: Callable[..., RunLine]
    said: Callable[[RunLine], str]


@dataclass
class Running:
    """A run in a process of its own."""

    job: Job
    folder: Path
    slot: Slot
    process: subprocess.Popen[bytes]
    log: IO[bytes]
    started: float = field(default_factory=time.monotonic)


def run_batch(
    jobs: Sequence[Job],
    places: Places,
    *,
    folders: Path,
    target: Callable[[Job], Target],
    known: Sequence[Path],
    keep: bool = False,
    retry_failed: bool = False,
    stop_after: float | None = None,
    say: Callable[[str], None] = print,
    program: Sequence[str] = HTS,
    kind: Kind | None = None,
) -> int:
    """Make the runs that have no line yet, in their order: none begins before one that comes before it, but where an
    earlier call still works on that. 0, 1 if one failed, STOPPED if `stop_after` seconds were not enough.

    known: files whose lines count as made; target: where new ones go. folders: one folder per run, deleted when its
    line is on the disk unless `keep`. program: takes a job's arguments and `--out FOLDER`, or `resume FOLDER`; kind:
    what it makes, whole runs where it is not said.
    """
    kind = kind or WHOLE_RUNS
    folders.mkdir(parents=True, exist_ok=True)
    made = lines_by_key(kind, known, retry_failed)
    waiting = [job for job in jobs if job.key not in made]
    failed = sum(made[job.key].status == "failed" for job in jobs if job.key in made)
    say(f"{len(jobs)} runs: {len(jobs) - len(waiting)} have a line already, {len(waiting)} to do, {places}")
    if not keep:  # killed between a line and its folder
        for job in jobs:
            if job.key in made and made[job.key].status == "done":
                _remove(folders / job.folder)
    running, begun, done = list[Running](), time.monotonic(), 0

    def end(one: Running) -> None:
        nonlocal failed, done
        to = target(one.job)
        line = _line(one, to.batch, kind)
        append(to.lines, line)
        done += 1
        failed += line.status == "failed"
        say(f"[{done}/{len(waiting_at_first)}] {one.job.folder}: {line.error or kind.said(line)}")
        if line.status == "done" and not keep:
            _remove(one.folder)
        places.give(one.slot)

    waiting_at_first = list(waiting)
    try:
        while waiting or running:
            if stop_after is not None and time.monotonic() - begun > stop_after:
                say(f"time is up: {len(running)} stopped in their midst, {len(waiting)} not begun; call again to go on")
                return STOPPED
            for job in [job for job in waiting if not _busy(folders / job.folder)]:
                slot = places.take(job)
                if slot is None:
                    break
                waiting.remove(job)
                running.append(_start(job, folders / job.folder, slot, program))
            for one in [one for one in running if one.process.poll() is not None]:
                running.remove(one)
                end(one)
            time.sleep(0.2)
    finally:
        _stop(running)
    return 1 if failed else 0


def lines_by_key(kind: Kind, known: Sequence[Path], retry_failed: bool) -> dict[str, RunLine]:
    """Lines that count as made, of those of these files that are there. retry_failed: those of failures do not."""
    made = {line.key: line for line in kind.made([path for path in known if path.exists()])}
    return {key: line for key, line in made.items() if line.status == "done" or not retry_failed}


def _start(job: Job, folder: Path, slot: Slot, program: Sequence[str]) -> Running:
    """Begin or resume a run in a process group of its own, on its cores."""
    if (folder / "config.yaml").exists():
        command = [*program, "resume", str(folder)]
    else:
        command = [*program, *job.arguments, "--out", str(folder)]
    environment = dict(os.environ)
    if slot.gpu is not None:
        environment["CUDA_VISIBLE_DEVICES"] = slot.gpu
    log = folder.with_suffix(".log").open("ab")
    process = subprocess.Popen(
        command,
        stdin=subprocess.DEVNULL,
        stdout=log,
        stderr=subprocess.STDOUT,
        env=environment,
        start_new_session=True,
        preexec_fn=dying_with_this(slot.cores),  # noqa: PLW1509 - this process has no other thread
    )
    return Running(job, folder, slot, process, log)


def dying_with_this(cores: Sequence[int] | None = None) -> Callable[[], None]:
    """For `Popen(preexec_fn=...)`: the process ends with the thread that starts it, however that ends, and keeps to
    these cores. On Linux; elsewhere it does nothing."""
    parent = os.getpid()
    libc = ctypes.CDLL(None) if sys.platform == "linux" else None

    def prepare() -> None:
        if libc is not None:
            if cores is not None:
                os.sched_setaffinity(0, cores)
            libc.prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
            if os.getppid() != parent:  # it died before that call
                os._exit(1)

    return prepare


def _line(one: Running, batch: str, kind: Kind) -> RunLine:
    """The line of a process that has ended. What cannot be read back is an error of the run too."""
    one.log.close()
    job, status, error, result = one.job, one.process.returncode, None, None
    if status == 0 and kind.finished(one.folder):
        try:  # its files may have another shape than this version knows
            result = kind.result(one.folder)
        except (HtsError, ValueError, KeyError, TypeError, AttributeError) as wrong:
            error = f"finished, but its files could not be read: {type(wrong).__name__}: {wrong}"
    else:
        said = _last_line(one.folder.with_suffix(".log")).replace(f"{one.folder.parent}/", "")
        error = f"exit status {status}: {said}"
    versions, hardware = provenance_of(one.folder)
    return kind.line(
        key=job.key,
        status="failed" if error else "done",
        error=error,
        batch=batch,
        method=job.method,
        method_hash=job.method_hash,
        reality=job.reality,
        reality_hash=job.reality_hash,
        seed=job.seed,
        preset=job.preset,
        commit=job.commit,
        arguments=[_short(text) for text in job.arguments],
        ended=datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        seconds_here=round(time.monotonic() - one.started, 1),
        versions=versions,
        hardware={**hardware, "cores_used": len(one.slot.cores), "gpu": one.slot.gpu},
        result=result,
    )


def _short(argument: str) -> str:
    """Without the folders of a reality's file: a line says nothing of the machine's paths."""
    key, equals, value = argument.partition("=")
    return f"{key}={Path(value).name}" if equals and "/" in value else argument


def _said(line: RunLine) -> str:
    assert isinstance(line, Line) and line.result is not None
    speeds = {
        name: {speed: round(row.improvement, 4) for speed, row in (found.held or found.open_loop or {}).items()}
        for name, found in line.result.objectives.items()
    }
    return f"{line.seconds_here:.0f} s, best {line.result.final_policy}, {speeds}"


WHOLE_RUNS = Kind(finished, result_of, read_lines, Line, _said)


def _last_line(path: Path) -> str:
    """What it ended with: its last line or, after a traceback, the exception's, which some libraries write advice
    below."""
    lines = [text.rstrip() for text in path.read_text(encoding="utf-8", errors="replace").splitlines() if text.strip()]
    begun = max((index for index, text in enumerate(lines) if text.startswith("Traceback (most")), default=len(lines))
    raised = [text for text in lines[begun:] if RAISED.match(text)]
    return (raised or lines or ["it said nothing"])[-1].strip()[:500]


def _busy(folder: Path) -> bool:
    """Whether a process of an earlier call still works in the folder."""
    try:
        with (folder / ".lock").open("r+") as file:
            return not take_lock(file)
    except OSError:  # there is none, or the run itself will say what is wrong with its folder
        return False


def _remove(folder: Path) -> None:
    """A run's folder and what it said."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.with_suffix(".log").unlink(missing_ok=True)


def _stop(running: Sequence[Running]) -> None:
    """End what runs; it goes on where it is when it is called again."""
    for number in (signal.SIGTERM, signal.SIGKILL):
        for one in running:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(one.process.pid, number)
        until = time.monotonic() + GRACE_SECONDS
        while time.monotonic() < until and any(one.process.poll() is None for one in running):
            time.sleep(0.05)
    for one in running:
        one.log.close()
