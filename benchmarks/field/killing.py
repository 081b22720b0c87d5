"""When `hts` or a visit is killed: once in the middle of each kind of stage."""

from __future__ import annotations

import subprocess
import time
from collections.abc import Callable
from pathlib import Path

from field import stages
from field.books import Books
from field.processes import kill

SHARE = 0.45  # of the least seconds that the same stage took in an earlier iteration
LAST_SHARE = 0.15  # in the last iteration: a first one is slow where something is loaded or compiled
BLIND = 1.0  # s into a stage of which no earlier one tells how long it is, where there is one iteration only


class Killer:
    """wanted: kinds of stages, and KIND-visit; those that `books` hold are done. clock: s."""

    def __init__(
        self, wanted: tuple[str, ...], run: Path, books: Books, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._wanted, self._run, self._books, self._clock = wanted, run, books, clock
        self._stage: str | None = None
        self._began, self._stored = 0.0, 0

    @property
    def pending(self) -> list[str]:
        """Kinds that were not killed yet."""
        done = {entry["what"] for entry in self._books.entries("kills")}
        return [one for one in self._wanted if one not in done]

    def line(self, text: str) -> None:
        """A line that `hts` printed."""
        if stages.begins(text):
            self._stage, self._began = stages.current(self._run), self._clock()
            self._stored = stages.recordings(self._run)

    def ended(self) -> None:
        """The process is gone."""
        self._stage = None

    def look(self, process: subprocess.Popen[str]) -> bool:
        """Kill `hts` if it is in the middle of a stage that is to be killed."""
        name = self._stage
        if name is None or stages.kind_of(name) not in self.pending or (self._run / f"{name}.json").exists():
            return False
        into = self._clock() - self._began
        stored = stages.recordings(self._run) - self._stored
        if stages.kind_of(name) in stages.IN_THE_WORLD:
            if stored < 1:  # some recordings are in the store, the others are not
                return False
        else:
            moment = self._moment(name)
            if not self._checkpoint(name) and (moment is None or into < moment):
                return False
        left = self._checkpoint(name)
        kill(process)
        if (self._run / f"{name}.json").exists():  # just too late
            return False
        self._note(stages.kind_of(name), name, into, recordings_stored=stored, checkpoint=left)
        return True

    def visit(self, kind: str, logs: Path, rows: int) -> bool:
        """Whether a visit of so many rows that writes into `logs` is now in the middle of a row, not its first one if
        there are several, and is to be killed."""
        if f"{kind}-visit" not in self.pending:
            return False
        whole = len(list(logs.glob("*.csv")))
        return whole >= min(1, rows - 1) and any(one.stat().st_size > 0 for one in logs.glob(".*.csv.partial"))

    def visit_killed(self, kind: str, stage: str, into: float, whole: int) -> None:
        """A visit was killed; whole: rows that it had recorded."""
        self._note(f"{kind}-visit", stage, into, whole_rows=whole)

    def _moment(self, name: str) -> float | None:
        """Seconds into a stage at which to kill it; None: not in this iteration."""
        known = [v for k, v in stages.seconds(self._run).items() if stages.kind_of(k) == stages.kind_of(name)]
        iterations = stages.iterations(self._run)
        if known:
            last = name.startswith(f"iterations/{iterations - 1:02d}/")
            return (LAST_SHARE if last else SHARE) * min(known)
        return BLIND if iterations == 1 else None

    def _checkpoint(self, name: str) -> bool:
        """Whether fine-tuning has left something to go on from: the best moment there is."""
        return stages.kind_of(name) == "finetune" and any(self._run.glob(f"{Path(name).parent}/checkpoint*"))

    def _note(self, what: str, stage: str, into: float, **more: object) -> None:
        print(f"killed {what} ({stage}) {into:.1f} s into it", flush=True)
        finished = stages.stamps(self._run)
        self._books.add("kills", what=what, stage=stage, seconds_into=round(into, 2), finished=finished, **more)
