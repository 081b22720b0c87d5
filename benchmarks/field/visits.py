"""Visits to the robot: a stand-in and the runtime, two processes at the two ends of a UDP line that is bad."""

from __future__ import annotations

import hashlib
import json
import os
import re
import shutil
import subprocess
import threading
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from field.books import Books
from field.killing import Killer
from field.processes import kill, start, tail

MOST_TRIES = 8  # of one visit
CONTROL_MS = 20.0
ONE_THREAD = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}  # pairs side by side need no more
ROBOTS_PRIORITY = "10"  # a robot's own computer serves nobody else; the runtime's is higher
TIMES = (
    *("steps", "step_ms_mean", "step_ms_p999", "step_ms_worst", "late_ms_p999", "late_ms_worst"),
    *("missed_deadlines", "memory_mb"),
)
ENDED = re.compile(r"(\d+) falls, ([\d.]+) s, (\d+) packets lost, (\d+) late")


@dataclass(frozen=True)
class Line:
    """How visits are made: the reality that the robot is, shares of lost and late packets each way, whether in real
    time, s of walking before a head-to-head (None: as the bundle says), robots that work side by side, a seed."""

    reality: str
    loss: float
    late: float
    real_time: bool
    warmup: float | None
    robots: int
    seed: int


class CannotRecord(Exception):
    """A row could not be recorded; one line."""


class Recorder:
    """Records every row of the bundles that wait. place: where visits have their copies of a bundle."""

    def __init__(self, line: Line, run: Path, place: Path, books: Books, killer: Killer) -> None:
        self.line, self._run, self._place, self._books, self._killer = line, run, place, books, killer
        self._lock = threading.Lock()

    def waiting(self) -> list[Path]:
        """Bundles with rows that have no log."""
        found = [path.parent for path in self._run.rglob("field/*/manifest.json") if path.parent.name[0] != "."]
        return [bundle for bundle in found if self._missing(bundle, self._rows(bundle))]

    def record(self, bundle: Path, kind: str, stage: str) -> None:
        """All rows of a bundle. kind, stage: of the run's stage that waits for it. Raises CannotRecord."""
        began = time.monotonic()
        visits = self._split(bundle)
        with ThreadPoolExecutor(self.line.robots) as robots:
            simulated = sum(robots.map(lambda rows: self._visit(bundle, rows, kind, stage), visits))
        took = time.monotonic() - began
        print(
            f"{bundle.name} ({stage}): {len(visits)} visits, {simulated:.0f} s of walking in {took:.0f} s", flush=True
        )
        self._books.add("bundles", bundle=bundle.name, stage=stage, visits=len(visits), wall_s=round(took, 1))

    # ------------------------------------------------------------------------------------------ inside

    @staticmethod
    def _rows(bundle: Path) -> list[dict[str, Any]]:
        return json.loads((bundle / "manifest.json").read_text())["rows"]

    @staticmethod
    def _missing(bundle: Path, rows: Sequence[dict[str, Any]]) -> list[str]:
        return [row["log"] for row in rows if not (bundle / "logs" / f"{row['log']}.csv").exists()]

    def _split(self, bundle: Path) -> list[list[dict[str, Any]]]:
        """One visit for all rows; where robots work side by side, one for each session of the bundle."""
        rows = self._rows(bundle)
        if self.line.robots == 1:
            return [rows]
        sessions: dict[str, list[dict[str, Any]]] = {}
        for row in rows:
            sessions.setdefault(row["session"], []).append(row)
        return list(sessions.values())

    def _visit(self, bundle: Path, rows: Sequence[dict[str, Any]], kind: str, stage: str) -> float:
        """Visits until all of these rows are recorded; simulated seconds. Several side by side must not share what a
        visit writes (the commands that were found by trimming), so each has a copy of the bundle."""
        place = self._place / bundle.name / rows[0]["log"]
        if not place.exists():
            half = place.with_name(f".{place.name}.partial")
            shutil.rmtree(half, ignore_errors=True)
            shutil.copytree(bundle, half, copy_function=os.link, ignore=shutil.ignore_patterns("logs"))
            (half / "logs").mkdir()
            half.rename(place)
        simulated = 0.0
        for attempt in range(MOST_TRIES):
            self._move(place, bundle)
            left = self._missing(bundle, rows)
            if not left:
                return simulated
            simulated += self._try(place, left, kind, stage, attempt)
        self._move(place, bundle)
        if self._missing(bundle, rows):
            raise CannotRecord(f"{place}: not recorded in {MOST_TRIES} visits: {tail(place / 'runtime.txt')}")
        return simulated

    @staticmethod
    def _move(place: Path, bundle: Path) -> None:
        """Whole logs into the bundle, the mapping first."""
        for log in sorted((place / "logs").glob("*.csv")):
            described = Path("logs", "mappings", f"{log.stem}.yaml")
            (bundle / described).parent.mkdir(exist_ok=True)
            os.replace(place / described, bundle / described)
            os.replace(log, bundle / "logs" / log.name)

    def _try(self, place: Path, rows: Sequence[str], kind: str, stage: str, attempt: int) -> float:
        """One visit; simulated seconds."""
        line, began = self.line, time.monotonic()
        lockstep = [] if line.real_time else ["--lockstep"]
        ticks = ["--priority", ROBOTS_PRIORITY] if line.real_time else ["--tick-ms", f"{CONTROL_MS:g}"]
        seed = int(hashlib.sha256(f"{line.seed}/{place}/{attempt}".encode()).hexdigest()[:7], 16)
        bad = ["--loss", str(line.loss), "--late", str(line.late), "--seed", str(seed)]
        options = ["--port", "0", "--reality", line.reality, *lockstep, *ticks, *bad]
        with (place / "robot.txt").open("a") as said, (place / "runtime.txt").open("a") as told:
            robot = start("hts_go1_stand_in", options, subprocess.PIPE, said, **ONE_THREAD, PYTHONWARNINGS="ignore")
            runtime = None
            try:
                assert robot.stdout is not None
                ready = robot.stdout.readline()
                if not ready.startswith("ready"):
                    raise CannotRecord(f"The robot's stand-in did not start: {tail(place / 'robot.txt')}")
                address, scale = ready.removeprefix("ready on ").split(", ")  # "ready on 127.0.0.1:9870, 12.2 kg"
                mass = scale.split()[0]
                asked = [
                    "--rows",
                    ",".join(rows),
                    "--idle-seconds",
                    "2",
                    "--mass",
                    mass,
                    "--yes",
                    "--at-limit",
                    *lockstep,
                ]
                asked += [] if line.warmup is None else ["--warmup", str(line.warmup)]
                asked += [] if line.real_time else ["--priority", "0"]  # a simulation waits
                link = f"udp://{address}"
                runtime = start(
                    "hts_go1_runtime", ["run", str(place), "--link", link, *asked], told, told, **ONE_THREAD
                )
                code = self._watch(runtime, place, rows, kind, stage)
                return self._noted(place, rows, stage, robot, code, began)
            finally:
                for process in (runtime, robot):
                    if process is not None:
                        kill(process)

    def _watch(
        self, runtime: subprocess.Popen[str], place: Path, rows: Sequence[str], kind: str, stage: str
    ) -> int | None:
        """Exit code of the runtime; None if it was killed."""
        began, moment = time.monotonic(), False
        while runtime.poll() is None:
            time.sleep(0.02)
            with self._lock:  # one visit is killed, not all that are at it
                if not moment and self._killer.visit(kind, place / "logs", len(rows)):
                    kill(runtime)
                    whole = len(list((place / "logs").glob("*.csv")))
                    self._killer.visit_killed(kind, stage, time.monotonic() - began, whole)
                    return None
        return runtime.returncode

    def _noted(
        self,
        place: Path,
        rows: Sequence[str],
        stage: str,
        robot: subprocess.Popen[str],
        code: int | None,
        began: float,
    ) -> float:
        """Into the books what both ends counted; simulated seconds."""
        robot.terminate()
        assert robot.stdout is not None
        ended = ENDED.search(robot.stdout.read())
        falls, clock, lost, late = (float(one) for one in ended.groups()) if ended else (0.0, 0.0, 0.0, 0.0)
        said = [json.loads(one) for one in _lines(place / "logs" / "events.jsonl")]
        figures: dict[str, Any] = next((one for one in reversed(said) if one["what"] == "figures"), {})
        (place / "logs" / "events.jsonl").rename(place / f"events-{len(list(place.glob('events-*')))}.jsonl")
        stopped = next((one["reason"] for one in said if one["what"] == "stopped"), None)
        self._books.add(
            "visits",
            stage=stage,
            place=f"{place.parent.name}/{place.name}",
            rows=len(rows),
            code=code,
            stopped=stopped,
            simulated_s=clock,
            wall_s=round(time.monotonic() - began, 2),
            falls=int(falls),
            line={"lost": int(lost), "late": int(late)},
            states={key: figures["packets"][key] for key in ("received", "lost", "late")} if figures else None,
            **{key: figures[key] for key in TIMES if figures},
        )
        if code not in (0, None):
            print(
                f"{place.parent.name}/{place.name}: visit ended with {code}: {tail(place / 'runtime.txt', 1)}",
                flush=True,
            )
        return clock


def _lines(path: Path) -> list[str]:
    """Whole lines of a file that a killed process may have left."""
    if not path.exists():
        path.touch()
    return [line for line in path.read_text().splitlines() if line.endswith("}")]
