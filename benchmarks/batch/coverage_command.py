"""`benchmarks/realities.py coverage run|table`: its options."""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

from batch.coverage import Work, policies_of, run_coverage, works_of
from batch.coverage_lines import Lengths, coverage_table, pairs_table, read_coverage
from batch.lines import files_of
from batch.methods import realities_of

FOLDER = Path(__file__).resolve().parents[2] / "docs/results/coverage"


def run(given: argparse.Namespace, commit_of: Callable[[str | None], str]) -> int:
    """Make the lines that are not there yet."""
    from hts.evaluation.evaluate import policy_file
    from hts.worlds.realities.batch import exported_policy

    with tempfile.TemporaryDirectory() as folder:
        reference = Path(given.reference) if given.reference else exported_policy(given.robot, Path(folder))
        policies = policies_of(given.policies)
        evaluated = Lengths(sessions=given.sessions, warmup=given.warmup, trimming=given.trim, block=given.block)
        true = Lengths(
            sessions=given.truth_sessions, warmup=given.warmup, trimming=given.truth_trim, block=given.truth_block
        )
        settings = [*(given.set or []), *([f"evaluation.speeds=[{given.speeds}]"] if given.speeds else [])]
        works = works_of(
            policies,
            policy_file(Path(folder), reference),
            realities_of(given.realities),
            given.repetitions,
            objective=given.objective,
            robot=given.robot,
            preset=given.preset,
            settings=settings,
            evaluated=evaluated,
            true=true,
            commit=commit_of(given.commit),
        )
        works = [work for work in works if given.only in (None, kind_of(work))]
        if given.dry_run:
            for work in works:
                print(work.key, work.name, work.reality, "truth" if work.repetition is None else work.repetition)
            return 0
        workers = given.workers or len(os.sched_getaffinity(0))
        return run_coverage(
            works,
            given.lines,
            workers,
            stop_after=given.stop_after,
            say=lambda text: print(text, file=sys.stderr, flush=True),
        )


def kind_of(work: Work) -> str:
    """As --only names it."""
    return "truths" if work.repetition is None else "evaluations"


def table(given: argparse.Namespace) -> int:
    """Print what the lines say, as markdown."""
    lines = read_coverage(files_of(given.lines or [FOLDER]))
    print(coverage_table(lines))
    print()
    print(pairs_table(lines))
    return 0


def add_to(commands: Any, commit_of: Callable[[str | None], str]) -> None:
    """The subcommands."""
    top = commands.add_parser("coverage", help="how often the interval of an evaluation holds the truth: run, table")
    kinds = top.add_subparsers(dest="kind", required=True)

    one = kinds.add_parser("run", help="make the evaluations and truths that have no line yet")
    one.set_defaults(do=lambda given: run(given, commit_of))
    one.add_argument(
        "--policies", type=Path, nargs="+", required=True, help=".onnx files, run folders, folders of either"
    )
    one.add_argument("--realities", required=True, help="as of `run`")
    one.add_argument("--repetitions", type=int, default=30, help="R evaluations of each pair (default: 30)")
    one.add_argument("--sessions", type=int, default=4, help="S of each evaluation (default: 4)")
    one.add_argument("--truth-sessions", type=int, default=50, help="K of each truth (default: 50)")
    one.add_argument("--speeds", help="m/s with commas (default: the preset's)")
    one.add_argument("--only", choices=("truths", "evaluations"), help="these alone, to share the work (default: both)")
    one.add_argument("--block", type=float, default=80.0, help="of an evaluation, s (default: 80)")
    one.add_argument("--trim", type=float, default=20.0, help="of an evaluation, s (default: 20)")
    one.add_argument("--warmup", type=float, default=20.0, help="of every session, s (default: 20)")
    one.add_argument("--truth-block", type=float, default=20.0, help="s (default: 20)")
    one.add_argument("--truth-trim", type=float, default=20.0, help="by the true speed, s (default: 20)")
    one.add_argument("--reference", type=Path, help="policy file (default: the one that the robot ships)")
    one.add_argument("--preset", default="quick", help="whose evaluation (default: quick)")
    one.add_argument("--objective", default="power")
    one.add_argument("--robot", default="go1")
    one.add_argument("--set", action="append", metavar="KEY=VALUE")
    one.add_argument("--lines", type=Path, required=True, help="file that lines are added to")
    one.add_argument("--workers", type=int, help="processes (default: one per core)")
    one.add_argument("--commit", help="default: HTS_COMMIT, or what git says")
    one.add_argument("--stop-after", type=float, metavar="SECONDS", help="begin nothing then; status 75; call again")
    one.add_argument("--dry-run", action="store_true", help="only say which lines these are")

    one = kinds.add_parser("table", help="what the lines say, as markdown")
    one.set_defaults(do=table)
    one.add_argument("--lines", type=Path, action="append", help="files or folders (default: docs/results/coverage)")
