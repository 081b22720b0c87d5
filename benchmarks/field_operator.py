"""A whole run in the world `field` with a script as operator: bundle -> runtime -> logs -> resume, until it is done.

    python benchmarks/field_operator.py --out OUT --reality dev-03 --kill all -- --preset smoke --set iterations=2

The robot is a simulated one (`hts_go1_stand_in`), in a process of its own at the end of a UDP line that loses and
delays packets; the runtime (`hts_go1_runtime`) is another process. What learns meets the reality only through the logs.
`--kill all` kills `hts` once in the middle of each kind of stage and, in each that needs the robot, a visit too
(SIGKILL to the process group), and goes on. The operator may be killed as well: the same command goes on.

OUT/run is the run, OUT/operator.json what was done, OUT/result.json what came of it, OUT/hts.txt what `hts` said,
OUT/visits the runtime's own logs of each visit. Exit code: that of the run; 75 if `--seconds` were over, and the same
command goes on.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any

from field import stages
from field.books import Books
from field.killing import Killer
from field.outcome import outcome
from field.processes import kill, start, tail
from field.visits import CannotRecord, Line, Recorder

from hts.atomic import atomic_write

WAITING = 75
EVERYTHING = (*stages.KINDS, *(f"{kind}-visit" for kind in stages.IN_THE_WORLD))
MOST_WITHOUT_PROGRESS = 3  # starts of hts in a row after which nothing was different


def main() -> int:
    """Exit code of the run: 0 if it was finished."""
    given = _parser().parse_args()
    wanted = _wanted(given.kill)
    given.out.mkdir(parents=True, exist_ok=True)
    books = Books(given.out)
    run = given.out / "run"
    killer = Killer(wanted, run, books)
    line = Line(given.reality, given.loss, given.late, given.real_time, given.warmup, given.robots, given.seed)
    recorder = Recorder(line, run, given.out / "visits", books, killer)
    operator = Operator(given.out, ["--out", str(run), *given.run], books, killer, recorder, given.bundles)

    def result() -> dict[str, Any]:
        how = ("reality", "loss", "late", "robots", "real_time")
        found = {**{key: vars(given)[key] for key in how}, **outcome(run, books, wanted)}
        atomic_write(given.out / "result.json", json.dumps(found, indent=1) + "\n")
        print(given.out / "result.json", flush=True)
        return found

    def leave(*_: object) -> None:
        """Everything that was started ends with this process."""
        result()
        print("not finished; the same command goes on", flush=True)
        os._exit(WAITING)

    signal.signal(signal.SIGTERM, leave)
    signal.signal(signal.SIGINT, leave)
    if given.seconds:
        timer = threading.Timer(given.seconds, leave)
        timer.daemon = True
        timer.start()
    try:
        code = operator.work()
    except CannotRecord as error:
        print(error, file=sys.stderr, flush=True)
        code = 1
    operator.close()
    result()
    return code


class Operator:
    """Starts `hts`, records what it waits for, starts it again."""

    def __init__(
        self, out: Path, options: list[str], books: Books, killer: Killer, recorder: Recorder, bundles: int
    ) -> None:
        self._out, self._run, self._books, self._killer, self._recorder = out, out / "run", books, killer, recorder
        self._bundles = bundles  # after which it ends; 0: with the run
        self._first = ["run", "--objective", "power", "--robot", "go1", "--world", "field", *options]
        self._importing = ThreadPoolExecutor(1)
        self._imports: list[Future[None]] = []
        self._process: subprocess.Popen[str] | None = None

    def work(self) -> int:
        """Until the run is finished, or enough is recorded; its exit code."""
        fruitless, before = 0, ""
        while True:
            self._record()
            if 0 < self._bundles <= len(self._books.entries("bundles")):
                return self._imported(0)
            code = self._hts()
            if code not in (None, WAITING):
                return self._imported(code)
            waiting = [bundle.name for bundle in self._recorder.waiting()]
            now = f"{stages.stamps(self._run)} {waiting} {len(self._books.entries('kills'))}"
            fruitless, before = (fruitless + 1 if now == before else 0), now
            if fruitless >= MOST_WITHOUT_PROGRESS:
                raise CannotRecord(f"hts waits, and nothing is to be recorded: {tail(self._out / 'hts.txt')}")

    def _imported(self, code: int) -> int:
        """The exit code, once the imports beside have ended."""
        for one in self._imports:
            one.result()
        return code

    def close(self) -> None:
        """Leave no process behind."""
        self._importing.shutdown(wait=False, cancel_futures=True)
        if self._process is not None:
            kill(self._process)

    def _record(self) -> None:
        stage = stages.current(self._run)
        for bundle in self._recorder.waiting() if stage else []:
            assert stage is not None
            self._recorder.record(bundle, stages.kind_of(stage), stage)
            self._imports.append(self._importing.submit(self._import, bundle))

    def _hts(self) -> int | None:
        """Exit code of `hts run` or `hts resume`; None if it was killed."""
        command = ["resume", str(self._run)] if (self._run / "config.yaml").exists() else self._first
        began = time.monotonic()
        with (self._out / "hts.txt").open("a") as said:
            self._process = process = start("hts.cli.main", command, subprocess.PIPE, subprocess.STDOUT)
            reader = threading.Thread(target=self._read, args=(process, said), daemon=True)
            reader.start()
            killed = False
            while process.poll() is None and not killed:
                killed = self._killer.look(process)
                time.sleep(0.005)
            reader.join(5.0)
            self._killer.ended()
        code = None if killed else process.returncode
        kill(process)
        self._process = None
        self._books.add("starts", command=command[0], code=code, wall_s=round(time.monotonic() - began, 2))
        return code

    def _read(self, process: subprocess.Popen[str], said: object) -> None:
        assert process.stdout is not None
        try:
            for text in process.stdout:
                print(text, end="", file=said, flush=True)  # type: ignore[call-overload]
                print(text, end="", flush=True)
                self._killer.line(text)
        except ValueError:  # closed: the process was killed
            pass

    def _import(self, bundle: Path) -> None:
        """`hts import` of a bundle's first log, as a person would do it."""
        log = min((bundle / "logs").glob("*.csv"))
        described = bundle / "logs" / "mappings" / f"{log.stem}.yaml"
        options = ["--mapping", str(described), "--robot", "go1", "--to", str(self._out / "imported.zarr")]
        with (self._out / "import.txt").open("a") as said:
            process = start("hts.cli.main", ["import", str(log), *options], said, said)
            code = process.wait()
        self._books.add("imports", log=f"{bundle.name}/{log.name}", code=code)


def _wanted(text: str) -> tuple[str, ...]:
    if text in ("", "all"):
        return EVERYTHING if text else ()
    names = tuple(text.split(","))
    for name in names:
        if name not in EVERYTHING:
            sys.exit(f"--kill {name}: expected `all` or some of {', '.join(EVERYTHING)}.")
    return names


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description="A field run with a script as operator.")
    parser.add_argument("--out", type=Path, required=True, help="folder of the run and the operator's books")
    parser.add_argument("--reality", default="dev-03", help="that the robot is")
    parser.add_argument("--loss", type=float, default=0.01, help="share of lost packets, each way")
    parser.add_argument("--late", type=float, default=0.02, help="share of late packets, each way")
    parser.add_argument("--warmup", type=float, help="s of walking before a head-to-head (default: the bundle's)")
    parser.add_argument("--real-time", action="store_true", help="not in lockstep")
    parser.add_argument("--robots", type=int, default=1, help="side by side, a session each; 1: one visit a bundle")
    parser.add_argument("--kill", default="", help=f"`all` or some of {','.join(EVERYTHING)}")
    parser.add_argument("--seconds", type=float, default=0.0, help="stop after so many; 0: when it is done")
    parser.add_argument("--bundles", type=int, default=0, help="end once so many are recorded; 0: with the run")
    parser.add_argument("--seed", type=int, default=0, help="of the robots and their lines")
    parser.add_argument("run", nargs="*", help="options of `hts run`")
    return parser


if __name__ == "__main__":
    sys.exit(main())
