"""`benchmarks/realities.py exact`: candidates judged by the reality's own instruments."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from batch import exact
from batch.exact_lines import exact_table, read_exact
from batch.lines import files_of
from batch.methods import Job
from batch.queue import Kind

Batch = Callable[[argparse.Namespace, Sequence[Job], Kind, Sequence[str]], int]


def run(given: argparse.Namespace, jobs: Callable[[argparse.Namespace], list[Job]], batch: Batch) -> int:
    """Make the candidates that have no line yet."""
    asked = jobs(given)
    exact.check(asked, given.iteration)
    until = exact.jobs_until(asked, given.iteration)
    return batch(given, until, exact.kind(given.iteration), exact.program(given.iteration))


def table(given: argparse.Namespace) -> int:
    """Print what the lines say, as markdown."""
    print(exact_table(read_exact(files_of(given.lines)), given.against, given.objective))
    return 0


def add_to(
    commands: Any, options: argparse.ArgumentParser, jobs: Callable[[argparse.Namespace], list[Job]], batch: Batch
) -> None:
    """The subcommands. options: those of `run`; jobs, batch: what it does with them."""
    top = commands.add_parser(
        "exact", help="one iteration's candidates, judged by the reality's instruments: run, table"
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
