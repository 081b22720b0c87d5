"""Candidates of whole runs whose folders were kept, judged by the reality's own instruments afterwards.

A promise and a trial differ for two reasons: the measurement model errs, and simulated walks are not real ones. The
exact measurement of the very walks that were judged in the run stands between the two. It sees inside, and comes after
the run has ended, so nothing of it could choose anything there.
"""

from __future__ import annotations

import datetime
import shutil
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from batch.exact import judged
from batch.exact_lines import Exact, ExactLine, read_exact
from batch.lines import Line, RunLine, append
from batch.methods import digest
from hts.errors import ConfigError, HtsError
from hts.evaluation.final import speed_key
from hts.run.stages import read_json

Judge = Callable[[Path, int], Exact]


@dataclass(frozen=True)
class Work:
    """The candidates of one iteration of a run. key: of its line."""

    line: Line
    folder: Path
    iteration: int

    @property
    def key(self) -> str:
        return digest([self.line.key, "kept", self.iteration])[: len(self.line.key)]


def works_of(lines: Sequence[Line], folders: Path) -> list[Work]:
    """Every iteration in which a finished run tried somebody. Raises ConfigError for a run without its folder."""
    found = []
    for line in lines:
        if line.result is None:
            continue
        kept = [folder for folder in folders.glob(f"*-{line.key}") if folder.is_dir()]
        if not kept:
            raise ConfigError(
                f"{folders}: no folder of {line.method} on {line.reality}, seed {line.seed} (*-{line.key}). Expected "
                "what `run --keep` leaves; give --of the lines of runs that were kept."
            )
        found += [Work(line, kept[0], index) for index in sorted({one.iteration for one in line.result.tried})]
    return found


def judge_kept(works: Sequence[Work], lines: Path, say: Callable[[str], None], judge: Judge = judged) -> int:
    """Judge what has no line yet, on a copy of each folder. 0; 1 where one could not be judged, which its line says."""
    made = {line.key for line in read_exact([lines]) if line.status == "done"} if lines.exists() else set()
    waiting = [work for work in works if work.key not in made]
    say(f"{len(works)} iterations: {len(works) - len(waiting)} have a line already, {len(waiting)} to do")
    failed = 0
    for place, work in enumerate(waiting, start=1):
        line = _line(work, judge)
        append(lines, line)
        failed += line.error is not None
        say(f"[{place}/{len(waiting)}] {work.folder.name}, iteration {work.iteration}: {line.error or 'judged'}")
    return 1 if failed else 0


def _line(work: Work, judge: Judge) -> ExactLine:
    begun, found, error = time.monotonic(), None, None
    with tempfile.TemporaryDirectory() as scratch:
        copy = Path(scratch) / work.folder.name
        try:
            shutil.copytree(work.folder, copy, ignore=shutil.ignore_patterns(".lock"))
            told = judge(copy, work.iteration)
            found = told.model_copy(update={"same_walks": same_walks(work.folder, told)})
        except (HtsError, OSError, ValueError, KeyError) as wrong:  # a folder may have been touched since
            error = f"{type(wrong).__name__}: {wrong}".replace(f"{scratch}/", "")
    same = {name: getattr(work.line, name) for name in RunLine.model_fields}
    new = {
        "key": work.key,
        "status": "failed" if error else "done",
        "error": error,
        "ended": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        "seconds_here": round(time.monotonic() - begun, 1),
    }
    return ExactLine(**{**same, **new, "result": found})


def same_walks(folder: Path, found: Exact) -> bool:
    """Whether the run itself, when it judged these candidates, found the same falls and shares of good segments: on
    another computer, or with other sources, rounding makes other walks."""
    before = read_json(folder / f"iterations/{found.iteration:02d}/simulate.json")
    return all(
        one.falls == before["falls"][one.id]
        and one.valid == {speed_key(trial["speed"]): trial["valid"] for trial in before["trials"][one.id]}
        for one in found.candidates
    )
