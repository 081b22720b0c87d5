"""How well does a twin from logs alone say what a run will save? One command over a list of realities.

    python benchmarks/expected.py run --realities dev-00,dev-03 --draws 4 --engine warp --gpus all --cores 2 --out DIR
    python benchmarks/expected.py table --out DIR

`run` records logs of each reality, draws realities that agree with them (OUT/REALITY/draws), makes the method's runs
on these and on the reality itself (OUT/runs, OUT/lines.jsonl) and writes OUT/expected.jsonl, one JSON line per reality.
With --measured, lines that are there already say what was saved. Stopped anywhere, the same command goes on. It needs
no network and no git (--commit, or HTS_COMMIT). `docs/benchmarks-realities.md` is its manual.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from batch import methods as known
from batch.answered import answered
from batch.expected import Fitting, compared, fitted
from batch.expected_lines import Expected, expected_table, read_expected, write_expected
from batch.expected_logs import Visit
from batch.groups import objectives_of
from batch.lines import Line, files_of, read_lines
from batch.methods import Job
from batch.places import slots_of
from batch.queue import STOPPED, Target, run_batch
from realities import commit_of, gpus_of

from hts.errors import ConfigError, HtsError, RunError, unknown_name

LINES, EXPECTED = "lines.jsonl", "expected.jsonl"


class TimeUp(Exception):
    """No time is left; what is done stays."""


def run(given: argparse.Namespace) -> int:
    """Everything that is not there yet."""
    begun, names = time.monotonic(), known.realities_of(given.realities)
    methods = known.read_methods(given.methods_file)
    if given.method not in methods:
        raise ConfigError(unknown_name("method", given.method, methods))
    commit = commit_of(given.commit)

    def jobs(realities: Sequence[str], seeds: Sequence[int]) -> list[Job]:
        return known.jobs_of(
            {given.method: methods[given.method]},
            realities,
            seeds,
            objectives=[given.objective],
            robot=given.robot,
            preset=given.preset,
            commit=commit,
            settings=given.set or [],
            engine=given.engine,
        )

    def left() -> float | None:
        return None if given.stop_after is None else given.stop_after - (time.monotonic() - begun)

    def tell(text: str) -> None:
        print(text, file=sys.stderr, flush=True)
        rest = left()
        if rest is not None and rest <= 0:
            raise TimeUp

    own = {Path(name).stem: name for name in names}
    if len(own) < len(names):
        raise ConfigError(f"--realities {given.realities}: two of them have one name. Give one file another name.")
    on_themselves = {Path(name).stem: jobs([name], known.seeds_of(given.seeds)) for name in names}
    measured = _measured(given, on_themselves)
    how = Fitting(
        robot=given.robot,
        count=given.draws,
        population=given.population,
        budget=given.budget,
        within=given.within,
        at_most=given.at_most,
        discrepancy=given.discrepancy,
        seed=given.draw_seed,
    )
    visit = Visit(sessions=given.sessions)
    given.out.mkdir(parents=True, exist_ok=True)
    files: dict[str, list[Path]] = {}
    failed: dict[str, str] = {}
    try:
        for name, reality in own.items():
            try:
                files[name] = fitted(reality, name, given.out / name, how, visit, [given.objective], tell)
            except HtsError as error:
                failed[name] = str(error)
                tell(f"{name}: {error}")
    except TimeUp:
        tell_last("time is up before the runs began; call again to go on")
        return STOPPED
    on_draws = {name: jobs([str(path) for path in paths], [given.run_seed]) for name, paths in files.items()}
    todo = [job for name, rows in on_draws.items() for job in rows]
    todo += [job for name in files if not measured[name] for job in on_themselves[name]]
    rest = left()
    status = run_batch(
        todo,
        slots_of(given.cores, gpus_of(given.gpus), given.jobs, sorted(os.sched_getaffinity(0))),
        folders=given.out / "runs",
        target=lambda _: Target(given.out / LINES, given.out.name),
        known=[given.out / LINES],
        keep=given.keep,
        retry_failed=given.retry_failed,
        stop_after=None if rest is None else max(rest, 0.0),
        say=tell_last,
    )
    made = {line.key: line for line in read_lines([path for path in [given.out / LINES] if path.exists()])}
    rows: list[Expected] = []
    about = {"method": given.method, "preset": given.preset, "commit": commit}
    for name, reality in own.items():
        which = (name, known.reality_hash(reality))
        if name in failed:
            rows.append(_failed(which, given.objective, about, failed[name]))
            continue
        if any(job.key not in made for job in on_draws[name]):
            continue  # the time was up
        lines = {job.reality: made[job.key] for job in on_draws[name]}
        there = measured[name] or [made[job.key] for job in on_themselves[name] if job.key in made]
        try:
            rows.append(compared(which, given.out / name / "draws", lines, there, given.objective, about))
        except RunError as error:
            rows.append(_failed(which, given.objective, about, str(error)))
    write_expected(given.out / EXPECTED, rows)
    print(expected_table(rows))
    return status or (1 if any(row.error for row in rows) else 0)


def _measured(given: argparse.Namespace, wanted: dict[str, list[Job]]) -> dict[str, list[Line]]:
    """Lines of --measured by reality: of its file, the method and the preset, whatever their commit and seed."""
    lines = read_lines(files_of(given.measured)) if given.measured else []
    return {
        name: [
            line
            for line in lines
            if line.result is not None
            and given.objective in objectives_of(line)
            and (line.method, line.preset, line.reality_hash) == (given.method, given.preset, jobs[0].reality_hash)
        ]
        for name, jobs in wanted.items()
    }


def _failed(which: tuple[str, str], objective: str, about: dict[str, str], error: str) -> Expected:
    return Expected(
        reality=which[0],
        reality_hash=which[1],
        objective=objective,
        unit="1",
        within=0.0,
        draws=0,
        worth=0.0,
        measured_runs=0,
        speeds={},
        error=error,
        **about,  # type: ignore[arg-type]
    )


def tell_last(text: str) -> None:
    """Progress that ends nothing."""
    print(text, file=sys.stderr, flush=True)


def show(given: argparse.Namespace) -> int:
    """Print the table again."""
    print(expected_table(read_expected(given.out / EXPECTED)))
    return 0


def parser() -> argparse.ArgumentParser:
    """The command line."""
    top = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = top.add_subparsers(dest="command", required=True)
    one = commands.add_parser("run", help="logs, draws, runs and the comparison, as far as they are not there")
    one.set_defaults(do=run)
    one.add_argument("--realities", required=True, help="dev, names, files or folders of files, with commas")
    one.add_argument("--out", type=Path, required=True, help="where everything goes")
    one.add_argument("--draws", type=int, default=4, help="realities to run on, for each (default: 4)")
    one.add_argument("--population", type=int, default=32, help="draws that are moved until they agree (default: 32)")
    one.add_argument("--budget", type=int, default=3000, help="simulations for each reality at most (default: 3000)")
    one.add_argument("--within", type=float, default=1.0, help="tolerances that draws may be away (default: 1)")
    one.add_argument("--at-most", type=float, default=2.0, help="the same, where the budget is spent (default: 2)")
    one.add_argument("--discrepancy", type=float, default=0.05, help="share of each figure (default: 0.05)")
    one.add_argument("--sessions", type=int, default=4, help="of the logs, at each speed (default: 4)")
    one.add_argument("--draw-seed", default="expected", help="any text")
    one.add_argument("--run-seed", type=int, default=0, help="of the runs on draws (default: 0)")
    one.add_argument("--method", default="ours")
    one.add_argument("--methods-file", type=Path)
    one.add_argument("--preset", default="quick")
    one.add_argument("--objective", default="power")
    one.add_argument("--robot", default="go1")
    one.add_argument("--engine")
    one.add_argument("--set", action="append", metavar="KEY=VALUE", help="of every run")
    one.add_argument("--measured", type=Path, action="append", help="lines of runs on the realities themselves")
    one.add_argument("--seeds", default="0", help="of runs on the realities, where no line says it (default: 0)")
    one.add_argument("--commit", help="default: HTS_COMMIT, or what git says")
    one.add_argument("--cores", type=int, default=2, help="per run (default: 2)")
    one.add_argument("--gpus", default="none", help="none, all, or names with commas; runs share them in turn")
    one.add_argument("--jobs", type=int, help="runs at a time at most (default: as many as there are cores for)")
    one.add_argument("--keep", action="store_true", help="keep run folders")
    one.add_argument("--retry-failed", action="store_true", help="resume runs whose line is an error")
    one.add_argument("--stop-after", type=float, metavar="SECONDS", help="stop then with status 75; call again")
    one = commands.add_parser("table", help="the comparison as markdown")
    one.set_defaults(do=show)
    one.add_argument("--out", type=Path, required=True)
    return top


def main(arguments: Sequence[str] | None = None) -> int:
    """0; 1 if a reality or a run failed; 2 for a mistake; 75 where the time was up."""
    return answered(parser(), arguments)


if __name__ == "__main__":
    sys.exit(main())
