"""`benchmarks/realities.py exact`: candidates judged by the reality's own instruments."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from batch.exact_gap import gap_table
from batch.exact_lines import exact_table, read_exact
from batch.groups import groups_of
from batch.lines import files_of, read_lines
from batch.methods import Job
from batch.queue import Kind

Batch = Callable[[argparse.Namespace, Sequence[Job], Kind, Sequence[str]], int]


def run(given: argparse.Namespace, jobs: Callable[[argparse.Namespace], list[Job]], batch: Batch) -> int:
    """Make the candidates that have no line yet."""
    from batch import exact  # with torch and all of a run, which no table and no page needs

    asked = jobs(given)
    exact.check(asked, given.iteration)
    until = exact.jobs_until(asked, given.iteration)
    return batch(given, until, exact.kind(given.iteration), exact.program(given.iteration))


def kept(given: argparse.Namespace) -> int:
    """Judge the candidates of whole runs that have no line yet."""
    from batch.exact_kept import judge_kept, works_of

    works = works_of(read_lines(files_of(given.of)), given.runs)
    return judge_kept(works, given.lines, lambda text: print(text, file=sys.stderr, flush=True))


def gap(given: argparse.Namespace) -> int:
    """Print where promises are lost, as markdown."""
    groups = groups_of(read_lines(files_of(given.of)), given.preset, objective=given.objective)
    print(gap_table(groups, read_exact(files_of(given.lines))))
    return 0


def table(given: argparse.Namespace) -> int:
    """Print what the lines say, as markdown."""
    print(exact_table(read_exact(files_of(given.lines)), given.against, given.objective))
    return 0


def add_to(
    commands: Any, options: argparse.ArgumentParser, jobs: Callable[[argparse.Namespace], list[Job]], batch: Batch
) -> None:
    """The subcommands. options: those of `run`; jobs, batch: what it does with them."""
    top = commands.add_parser(
        "exact", help="candidates, judged by the reality's instruments: run, table; of whole runs: kept, gap"
    )
    kinds = top.add_subparsers(dest="kind", required=True)

    one = kinds.add_parser("run", parents=[options], help="make the candidates that have no line yet")
    one.set_defaults(do=lambda given: run(given, jobs, batch))
    one.add_argument("--iteration", type=int, default=0, help="whose candidates (default: 0, the first)")

    one = kinds.add_parser("table", help="what the lines say, as markdown")
    one.set_defaults(do=table)
    one.add_argument("--lines", type=Path, action="append", required=True, help="files or folders")
    one.add_argument("--against", help="differences to this method")
    one.add_argument("--objective", help="default: the lines' first")

    one = kinds.add_parser("kept", help="judge the candidates of whole runs whose folders were kept")
    one.set_defaults(do=kept)
    one.add_argument("--of", type=Path, action="append", required=True, help="lines of the runs: files or folders")
    one.add_argument("--runs", type=Path, required=True, help="where their folders are (`run --keep`)")
    one.add_argument("--lines", type=Path, required=True, help="file that lines are added to")

    one = kinds.add_parser("gap", help="where their promises are lost: promised, by the instruments, measured")
    one.set_defaults(do=gap)
    one.add_argument("--of", type=Path, action="append", required=True, help="lines of the runs: files or folders")
    one.add_argument("--lines", type=Path, action="append", required=True, help="lines of `exact kept`")
    one.add_argument("--preset", help="of the runs, where their lines have several")
    one.add_argument("--objective", help="default: the lines' first")
