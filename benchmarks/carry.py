"""What a machine without network and git needs for a file for `realities.py several`: one folder to bring along.

    python benchmarks/carry.py docs/results/several/dev-28.yaml --realities dev-00,dev-01,dev-03 --out FOLDER
    FOLDER/start --gpus all --out ~/runs --lines ~/lines        # there

For each commit that the entries name, FOLDER gets the project's wheels, `benchmarks/` of that same commit (a later one
may import what those wheels do not have) and the entries, with the files of methods and realities that they name, as
they are now. `start` installs the wheels beside themselves, first on the path, and hands its options (paths from the
root) to `several`, commit after commit. The dependencies must be in that machine's Python (`PYTHON`, else python3).

Nothing is left to find out there: with this Python and its dependencies every run is resolved before this ends, and how
many there are is printed. --out must be new. Status 2 and one line for what cannot be packed.
"""

from __future__ import annotations

import argparse
import io
import os
import re
import shutil
import subprocess
import sys
import tarfile
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import yaml

REPOSITORY = Path(__file__).resolve().parents[1]
DISTRIBUTIONS = ("pyproject.toml", "plugins/*/pyproject.toml", "robots/*/pyproject.toml")
COMMIT = re.compile(r"[0-9a-f]{40}")
ENTRIES = "several.yaml"
START = """#!/bin/sh
# Options are those of `realities.py several`. --dry-run says which runs these are.
set -eu
here=$(cd "$(dirname "$0")" && pwd)
python=${PYTHON:-python3}
export OMP_NUM_THREADS="${OMP_NUM_THREADS:-1}"
for commit in @COMMITS@; do
    cd "$here/$commit"
    if ! test -d site; then
        "$python" -m pip install --quiet --no-index --no-deps --target site.new wheels/*.whl
        mv site.new site
    fi
    PYTHONPATH="$here/$commit/site${PYTHONPATH:+:$PYTHONPATH}" "$python" benchmarks/realities.py several @ENTRIES@ "$@"
done
"""


class CannotPackError(Exception):
    """One line: what was found, where, and what to do."""


def last_line(text: str) -> str:
    """What a program said last."""
    return text.strip().rpartition("\n")[2] or "it did not say why"


def chosen(file: Path, realities: Sequence[str]) -> dict[str, list[dict[str, Any]]]:
    """Batch -> its entries; of those that were asked for by name only, if any are."""
    read = yaml.safe_load(file.read_text())
    if not isinstance(read, dict) or not all(isinstance(rows, list) for rows in read.values()):
        raise CannotPackError(f"{file}: expected names of batches, each with a list of entries.")
    found: dict[str, list[dict[str, Any]]] = {}
    missing = set(realities)
    for batch, rows in read.items():
        for index, row in enumerate(rows):
            commit = row.get("commit")
            if not COMMIT.fullmatch(str(commit)):
                raise CannotPackError(f"{file}: {batch}.{index}: commit is {commit!r}. Expected its forty digits.")
            named = str(row.get("realities", "")).split(",")
            kept = [name for name in named if name in realities] if realities else named
            missing.difference_update(kept)
            if kept:
                found.setdefault(batch, []).append({**row, "realities": ",".join(kept)})
    if missing:
        raise CannotPackError(f"{file}: no entry names {', '.join(sorted(missing))}. --realities takes names from it.")
    return found


def brought(repository: Path, entry: dict[str, Any]) -> list[str]:
    """The files and folders of the repository that an entry names, as paths from its top."""
    named = [*str(entry["realities"]).split(","), *filter(None, [entry.get("methods_file")])]
    return [path for path in named if (repository / path).exists()]


def unpack(repository: Path, commit: str, into: Path) -> None:
    """The sources of a commit."""
    done = subprocess.run(["git", "archive", commit], cwd=repository, capture_output=True, check=False)
    if done.returncode:
        raise CannotPackError(f"git has no commit {commit} here: {done.stderr.decode().strip()}. Fetch it.")
    with tarfile.open(fileobj=io.BytesIO(done.stdout)) as archive:
        archive.extractall(into, filter="data")


def build(sources: Path, wheels: Path) -> None:
    """Wheels of the project's distributions, with the builder that is installed."""
    places = sorted(str(path.parent) for pattern in DISTRIBUTIONS for path in sources.glob(pattern))
    pip = (sys.executable, "-m", "pip", "--disable-pip-version-check", "wheel", "--quiet")
    done = subprocess.run(
        [*pip, "--no-deps", "--no-build-isolation", "--wheel-dir", str(wheels), *places],
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode:
        raise CannotPackError(f"pip could not build the wheels: {last_line(done.stderr)}")


def pack(repository: Path, file: Path, realities: Sequence[str], out: Path) -> None:
    """Fill `out`, a new folder."""
    batches = chosen(file, realities)
    commits = list(dict.fromkeys(row["commit"] for rows in batches.values() for row in rows))
    for commit in commits:
        place = out / commit
        with tempfile.TemporaryDirectory() as temporary:
            sources = Path(temporary)
            unpack(repository, commit, sources)
            build(sources, place / "wheels")
            shutil.copytree(sources / "benchmarks", place / "benchmarks")
        mine = {name: [row for row in rows if row["commit"] == commit] for name, rows in batches.items()}
        mine = {name: rows for name, rows in mine.items() if rows}
        for path in {path for rows in mine.values() for row in rows for path in brought(repository, row)}:
            (place / path).parent.mkdir(parents=True, exist_ok=True)
            if (repository / path).is_dir():  # where another entry may have put a file of it
                shutil.copytree(repository / path, place / path, dirs_exist_ok=True)
            else:
                shutil.copy(repository / path, place / path)
        (place / ENTRIES).write_text(yaml.safe_dump(mine, sort_keys=False))
    start = out / "start"
    start.write_text(START.replace("@COMMITS@", " ".join(commits)).replace("@ENTRIES@", ENTRIES))
    start.chmod(0o755)


def tried(out: Path) -> list[str]:
    """A line for each run, as `start --dry-run` resolves it in a copy, with this Python and a made-up GPU."""
    with tempfile.TemporaryDirectory() as temporary:
        copy = Path(temporary) / "carried"
        shutil.copytree(out, copy)
        done = subprocess.run(
            [str(copy / "start"), "--dry-run", "--gpus", "0", "--out", temporary, "--lines", str(copy / "lines")],
            env={**os.environ, "PYTHON": sys.executable},
            capture_output=True,
            text=True,
            check=False,
        )
    if done.returncode:
        raise CannotPackError(f"what was packed does not start: {last_line(done.stderr)}")
    return done.stdout.splitlines()


def main(arguments: Sequence[str] | None = None) -> int:
    """0, or 2 for what cannot be packed; then `--out` is not left behind."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("file", type=Path, help="YAML for `realities.py several`; each entry with its commit")
    parser.add_argument("--realities", default="", help="names with commas: those of its entries only")
    parser.add_argument("--out", type=Path, required=True, help="a new folder")
    parser.add_argument("--repository", type=Path, default=REPOSITORY, help="a checkout with git (default: this one)")
    given = parser.parse_args(arguments)
    if given.out.exists():
        parser.error(f"--out {given.out} is there already. Name a new folder.")
    try:
        pack(given.repository, given.file, [name for name in given.realities.split(",") if name], given.out)
        runs = tried(given.out)
    except (CannotPackError, OSError, yaml.YAMLError) as error:
        shutil.rmtree(given.out, ignore_errors=True)
        print(f"carry: {error}", file=sys.stderr)
        return 2
    size = sum(path.stat().st_size for path in given.out.rglob("*") if path.is_file())
    print(f"{given.out}: {len(runs)} runs, {size / 1e6:.1f} MB. There: {given.out.name}/start --out RUNS --lines LINES")
    return 0


if __name__ == "__main__":
    sys.exit(main())
