"""Methods × realities × seeds: many runs side by side, one JSON line each, and tables and figures from the lines.

    python benchmarks/realities.py run --methods ours,baseline --realities dev --seeds 0-1 --preset quick \\
        --out runs/dev --lines docs/results/lines/dev-quick.jsonl --cores 2
    python benchmarks/realities.py several docs/results/several/dev-23.yaml --out runs/several --gpus all
    python benchmarks/realities.py table --lines docs/results/lines/dev-quick.jsonl
    python benchmarks/realities.py figures --lines docs/results/lines/dev-quick.jsonl --out docs/results/figures
    python benchmarks/realities.py coverage run --policies FOLDER --realities dev --lines coverage.jsonl
    python benchmarks/realities.py exact run --methods ours --realities dev --iteration 0 --out runs/exact
    python benchmarks/realities.py write-docs

`run` skips what has a line, resumes what was begun, and loses nothing however it is stopped: call it again. It needs
no network and no git (`--commit`, or HTS_COMMIT, says which commit this is where git cannot).
`docs/benchmarks-realities.md` is its manual.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from batch import blocks, coverage_command, exact_command
from batch import methods as known
from batch.ablation import ablation
from batch.all_tables import ALL
from batch.answered import answered
from batch.groups import Group, groups_of
from batch.lines import files_of, read_lines
from batch.places import Machine, Places, slots_of
from batch.queue import HTS, WHOLE_RUNS, Kind, Target, lines_by_key, run_batch
from batch.several import Entry, planned
from batch.tables import pairs
from batch.together import together

from hts.atomic import atomic_write
from hts.errors import ConfigError, unknown_name

REPOSITORY = Path(__file__).resolve().parents[1]
LINES = REPOSITORY / "docs/results/lines"
FIGURES = REPOSITORY / "docs/results/figures"
OLDER = REPOSITORY / "docs/results/older-numbers.json"


def jobs_of(given: argparse.Namespace | Entry) -> list[known.Job]:
    """The runs that the options of `run` ask for, or an entry of a file for `several`."""
    table = known.read_methods(given.methods_file)
    names = [name for name in given.methods.split(",") if name]
    for name in names:
        if name not in table:
            raise ConfigError(unknown_name("method", name, table))
    return known.jobs_of(
        {name: table[name] for name in names},
        known.realities_of(given.realities),
        known.seeds_of(given.seeds),
        objectives=given.objective or ["power"],
        robot=given.robot,
        preset=given.preset,
        commit=commit_of(given.commit),
        settings=given.set or [],
        engine=given.engine,
    )


def run(given: argparse.Namespace) -> int:
    """Make the runs that have no line yet."""
    return made(given, jobs_of(given), WHOLE_RUNS, HTS)


def made(given: argparse.Namespace, jobs: Sequence[known.Job], kind: Kind, program: Sequence[str]) -> int:
    """Make those that have no line yet, or only say which they are."""
    target = Target(given.lines or given.out / "lines.jsonl", given.batch or given.out.name)
    targets = {job.key: target for job in jobs}
    if given.dry_run:
        state = _states(given, targets, kind)
        for job in jobs:
            print(f"{job.key} ({state(job)}) hts", *job.arguments)
        return 0
    places = slots_of(given.cores, gpus_of(given.gpus), given.jobs, sorted(os.sched_getaffinity(0)))
    return _made(given, jobs, places, targets, kind, program)


def several(given: argparse.Namespace) -> int:
    """Make the runs of several batches that have no line yet, on one machine."""

    def jobs(entry: Entry) -> list[known.Job]:
        return jobs_of(entry.model_copy(update={"commit": entry.commit or given.commit}))

    cores, gpus = sorted(os.sched_getaffinity(0)), gpus_of(given.gpus) or []
    works = planned(given.file, jobs, len(cores), gpus)
    if given.lines.exists() and not given.lines.is_dir():
        raise ConfigError(f"--lines {given.lines}: is a file; each batch gets one in it. Name a folder.")
    targets = {work.job.key: Target(given.lines / f"{work.batch}.jsonl", work.batch) for work in works}
    if given.dry_run:
        state = _states(given, targets, WHOLE_RUNS)
        for work in works:
            needs = f"{work.need.cores} cores{', GPU' if work.need.gpu else ''}"
            print(f"{work.job.key} {work.where} ({needs}, {state(work.job)}) hts", *work.job.arguments)
        return 0
    machine = Machine(cores, gpus, {work.job.key: work.need for work in works})
    return _made(given, [work.job for work in works], machine, targets, WHOLE_RUNS, HTS)


def _known(given: argparse.Namespace, targets: Mapping[str, Target]) -> list[Path]:
    """Files whose lines count as made."""
    return [*{target.lines: None for target in targets.values()}, *files_of(given.known or [])]


def _states(given: argparse.Namespace, targets: Mapping[str, Target], kind: Kind) -> Callable[[known.Job], str]:
    """What there is of a run: nothing, a line, or that of a failure."""
    lines = lines_by_key(kind, _known(given, targets), given.retry_failed)

    def state(job: known.Job) -> str:
        line = lines.get(job.key)
        return "to do" if line is None else "has a line" if line.status == "done" else "has a line, failed"

    return state


def _made(
    given: argparse.Namespace,
    jobs: Sequence[known.Job],
    places: Places,
    targets: Mapping[str, Target],
    kind: Kind,
    program: Sequence[str],
) -> int:
    """targets: by the job's key."""
    if given.out.exists() and not given.out.is_dir():
        raise ConfigError(f"--out {given.out}: is a file; runs get folders in it. Name a folder.")
    return run_batch(
        jobs,
        places,
        folders=given.out,
        target=lambda job: targets[job.key],
        known=_known(given, targets),
        keep=given.keep,
        retry_failed=given.retry_failed,
        stop_after=given.stop_after,
        say=lambda text: print(text, file=sys.stderr, flush=True),
        program=program,
        kind=kind,
    )


def chosen_groups(given: argparse.Namespace) -> list[Group]:
    """What the options of `table` and `figures` choose."""
    lines = read_lines(files_of(given.lines or [LINES]))
    methods, as_one = ([] if one is None else one.split(",") for one in (given.methods, given.as_one))
    return groups_of(lines, given.preset, methods or None, given.objective, as_one)


def table(given: argparse.Namespace) -> int:
    """Print tables as markdown."""
    groups = chosen_groups(given)
    asked = given.ablation or given.together
    if given.together:
        print(f"### together\n\n{together(groups, given.against or 'ours')}\n")
    if given.ablation:
        print(f"### ablation\n\n{ablation(groups, given.against or 'ours')}\n")
    names = [given.name] if given.name else [] if asked else list(ALL)
    for name in names:
        if name not in ALL:
            raise ConfigError(unknown_name("table", name, ALL))
        print(f"### {name}\n\n{ALL[name](groups)}\n")
    if not asked and (given.against or not given.name):
        against = given.against or groups[0].name
        print(f"### against {against}\n\n{pairs(groups, against)}\n")
    for line in (line for group in groups for line in group.lines if line.error):
        print(f"failed: {line.method}, {line.reality}, seed {line.seed}: {line.error}")
    return 0


def figures(given: argparse.Namespace) -> int:
    """Write figures; print their names."""
    from batch.figures import draw

    groups = chosen_groups(given)
    prefix = given.prefix or groups[0].lines[0].preset
    for path in draw(groups, given.out, prefix):
        print(path)
    return 0


def write_docs(given: argparse.Namespace) -> int:
    """Fill the blocks of the pages from the lines; with --check only say which are not up to date."""
    older, stale, left = blocks.read_older(OLDER), [], {}
    for page in blocks.pages(REPOSITORY):
        before = page.read_text(encoding="utf-8")
        after = blocks.written(before, LINES)
        name = str(page.relative_to(REPOSITORY))
        if after != before:
            stale.append(name)
        if name in blocks.NUMBER:
            left[name] = blocks.remaining(name, after, older.get(name, {}))
            for number in blocks.strangers(name, after, older.get(name, {})):
                print(f"{name}: {number} comes from no line: put a block there (docs/benchmarks-realities.md)")
                stale.append(name)
        if after != before and not given.check:
            atomic_write(page, after)
    if not given.check:
        if left != older:
            atomic_write(OLDER, blocks.older_text(left))
        return 0
    if left != older:
        stale.append(str(OLDER.relative_to(REPOSITORY)))
    for name in dict.fromkeys(stale):
        print(f"{name}: is not what the lines say. Run: python benchmarks/realities.py write-docs")
    return 1 if stale else 0


def commit_of(given: str | None) -> str:
    """The commit that runs are made with. Raises ConfigError where nobody knows it, or sources differ from it."""
    stated = given or os.environ.get("HTS_COMMIT")
    if stated:
        return stated
    try:
        found, changed = (
            subprocess.run(
                ["git", *arguments], cwd=REPOSITORY, capture_output=True, text=True, check=True
            ).stdout.strip()
            for arguments in (("rev-parse", "HEAD"), ("status", "--porcelain", "--untracked-files=no", "--", "hts"))
        )
    except (OSError, subprocess.SubprocessError) as error:
        raise ConfigError("git does not say which commit this is. Say it: --commit HASH, or HTS_COMMIT.") from error
    if changed:
        raise ConfigError(
            f"hts/ differs from commit {found[:12]}, and lines are kept by commit. Commit first; to try something out: "
            "--commit NAME."
        )
    return found


def gpus_of(text: str) -> list[str] | None:
    """For CUDA_VISIBLE_DEVICES in turn: `none` hides all GPUs, `all` takes those there are, else names with commas."""
    if text == "none":
        return []
    if text != "all":
        return [name for name in map(str.strip, text.split(",")) if name]
    if "CUDA_VISIBLE_DEVICES" in os.environ:
        return [name for name in os.environ["CUDA_VISIBLE_DEVICES"].split(",") if name]
    import torch

    return [str(index) for index in range(torch.cuda.device_count())]


def positive(text: str) -> int:
    """Of an option. Raises ArgumentTypeError."""
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"expected a whole number of at least 1, found {text!r}")
    return int(text)


def parser() -> argparse.ArgumentParser:
    """The command line."""
    top = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = top.add_subparsers(dest="command", required=True)

    one = queueing = argparse.ArgumentParser(add_help=False)
    one.add_argument("--out", type=Path, required=True, help="where run folders go")
    one.add_argument("--known", type=Path, action="append", help="more files or folders whose lines count as made")
    one.add_argument("--commit", help="default: HTS_COMMIT, or what git says")
    one.add_argument("--gpus", default="none", help="none, all, or names with commas; runs share them")
    one.add_argument("--keep", action="store_true", help="keep run folders")
    one.add_argument("--retry-failed", action="store_true", help="resume those whose line is an error")
    one.add_argument("--stop-after", type=float, metavar="SECONDS", help="stop then with status 75; call again")
    one.add_argument("--dry-run", action="store_true", help="only say which runs these are, and which have a line")

    one = making = argparse.ArgumentParser(add_help=False, parents=[queueing])
    one.add_argument("--methods", required=True, help="names with commas; benchmarks/batch/methods.py lists them")
    one.add_argument("--methods-file", type=Path, help="YAML with more methods: name -> command, preset, set")
    one.add_argument("--realities", required=True, help="dev, default, names, files or folders of files, with commas")
    one.add_argument("--seeds", default="0", help="for instance 0-4 (default: 0)")
    one.add_argument("--preset", default="quick")
    one.add_argument("--objective", action="append", help="default: power")
    one.add_argument("--robot", default="go1")
    one.add_argument("--engine")
    one.add_argument("--set", action="append", metavar="KEY=VALUE", help="of every method")
    one.add_argument("--lines", type=Path, help="file that lines are added to (default: OUT/lines.jsonl)")
    one.add_argument("--batch", help="name of the batch in its lines (default: the name of OUT)")
    one.add_argument("--cores", type=positive, default=2, help="per run (default: 2)")
    one.add_argument("--jobs", type=positive, help="runs at a time at most (default: as many as there are cores for)")

    one = commands.add_parser("run", parents=[making], help="make the runs that have no line yet")
    one.set_defaults(do=run)

    one = commands.add_parser("several", parents=[queueing], help="make those of several batches on one machine")
    one.set_defaults(do=several)
    one.add_argument("file", type=Path, help="YAML: name of a batch -> list of its runs, as options of `run`")
    one.add_argument("--lines", type=Path, default=LINES, help="folder of their lines (default: docs/results/lines)")

    reading = argparse.ArgumentParser(add_help=False)
    reading.add_argument("--lines", type=Path, action="append", help="files or folders (default: docs/results/lines)")
    reading.add_argument("--preset", help="of the lines, where they have several")
    reading.add_argument("--methods", help="names with commas, in the order to be shown (default: all)")
    reading.add_argument("--as-one", help="methods, with commas, whose versions do the same and count as one")
    reading.add_argument("--objective", help="default: the lines' first")

    one = commands.add_parser("table", parents=[reading], help="tables as markdown")
    one.set_defaults(do=table)
    one.add_argument("--name", help=f"one of {', '.join(ALL)} (default: all)")
    one.add_argument("--ablation", action="store_true", help="each method less `ours` (--against), per reality")
    one.add_argument("--together", action="store_true", help="each version less `ours` (--against), and all of them")
    one.add_argument("--against", help="differences to this method (default: the first)")

    one = commands.add_parser("figures", parents=[reading], help="figures as SVG and PNG")
    one.set_defaults(do=figures)
    one.add_argument("--out", type=Path, default=FIGURES)
    one.add_argument("--prefix", help="of the files (default: the preset)")

    coverage_command.add_to(commands, commit_of)
    exact_command.add_to(commands, making, jobs_of, made)

    one = commands.add_parser("write-docs", help="fill the blocks of README and docs from docs/results/lines")
    one.set_defaults(do=write_docs)
    one.add_argument("--check", action="store_true", help="write nothing; status 1 where something is not up to date")
    return top


def main(arguments: Sequence[str] | None = None) -> int:
    """0; 1 if a run failed or something is not as it should be; 2 for a mistake; 75 where the time was up."""
    return answered(parser(), arguments)


if __name__ == "__main__":
    sys.exit(main())
