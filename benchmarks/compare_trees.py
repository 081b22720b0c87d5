"""One bench of two source trees, in alternating pairs: by how much is the new one faster than the old one?

    python benchmarks/compare_trees.py OLD NEW [--bench train] [--pairs 12] [--seconds 10] [--out FILE] [--robot go1
    ...]

OLD and NEW are checkouts, for instance made by `git worktree add`; other options are those of `hts bench`. Both run in
this Python, each measurement in a process of its own with the tree's sources first on the path. Which of the two goes
first changes from pair to pair, so that a machine that slows down meets both. Prints JSON: of `ratio` (of bare physics)
and `steps_per_s` the geometric mean of new over old and its 95 % t-interval over pairs, every measurement, and how many
cores others used meanwhile.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import statistics
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from compare_cpu import busy_cores
from output import give
from scipy import stats

FIGURES = ("ratio", "steps_per_s")
LEVEL = 0.95


def new_over_old(pairs: Sequence[tuple[float, float]]) -> tuple[float, float, float]:
    """Geometric mean of new / old over two or more pairs (old, new), and both ends of its t-interval at `LEVEL`."""
    logarithms = [math.log(new / old) for old, new in pairs]
    mean, error = statistics.mean(logarithms), statistics.stdev(logarithms) / math.sqrt(len(logarithms))
    reach = float(stats.t.ppf((1 + LEVEL) / 2, len(logarithms) - 1)) * error
    return math.exp(mean), math.exp(mean - reach), math.exp(mean + reach)


def sources(tree: Path) -> str:
    """PYTHONPATH of a checkout: the core and every distribution in it."""
    folders = [tree, *sorted(path.parent for path in tree.glob("*/*/pyproject.toml"))]
    return os.pathsep.join(map(str, folders))


def python(tree: Path, *arguments: str) -> str:
    """What Python prints, run in a tree with its sources first."""
    done = subprocess.run(
        [sys.executable, *arguments],
        check=False,
        cwd=tree,
        env={**os.environ, "PYTHONPATH": sources(tree)},
        text=True,
        stdout=subprocess.PIPE,
        stderr=None if os.environ.get("SHOW") else subprocess.DEVNULL,
    )
    if done.returncode:
        sys.exit(f"{' '.join(arguments)} ended with status {done.returncode} in {tree}. SHOW=1 shows what it printed.")
    return done.stdout


def check(tree: Path) -> None:
    """End here if `hts` comes from elsewhere."""
    found = Path(python(tree, "-c", "import hts; print(hts.__file__)").strip())
    if not found.is_relative_to(tree):
        sys.exit(f"{tree}: `import hts` gives {found}. Expected a checkout of the project.")


def compare(trees: tuple[Path, Path], bench: str, pairs: int, seconds: float, options: Sequence[str]) -> dict[str, Any]:
    """`pairs` measurements of each of (old, new)."""
    command = ("-m", "hts.cli.main", "bench", bench, "--json", "--seconds", str(seconds), *options)
    found: list[list[dict[str, Any]]] = [[], []]
    load: list[float] = []
    for pair in range(pairs):
        load.append(busy_cores())
        for which in (0, 1) if pair % 2 == 0 else (1, 0):
            found[which].append(json.loads(python(trees[which], *command)))
        print(f"pair {pair + 1}: " + " -> ".join(f"{each[-1]['ratio']:.3f}" for each in found), file=sys.stderr)
    result: dict[str, Any] = {"benchmark": "compare_trees", "bench": bench, "options": list(options), "pairs": pairs}
    for name in FIGURES:
        old, new = ([one[name] for one in each] for each in found)
        mean, low, high = new_over_old(list(zip(old, new, strict=True)))
        result[name] = {
            "new_over_old": round(mean, 4),
            "interval": [round(low, 4), round(high, 4)],
            "old": [round(value, 4) for value in old],
            "new": [round(value, 4) for value in new],
            "median_old": round(statistics.median(old), 4),
            "median_new": round(statistics.median(new), 4),
        }
    return result | {"others_busy_cores": [round(one, 2) for one in load]}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("old", type=Path)
    parser.add_argument("new", type=Path)
    parser.add_argument("--bench", default="train", choices=("env", "train"))
    parser.add_argument("--pairs", type=int, default=12, help="at least 2")
    parser.add_argument("--seconds", type=float, default=10.0, help="of each measurement, at least")
    parser.add_argument("--out", type=Path, help="write the JSON here too")
    given, options = parser.parse_known_args()
    if given.pairs < 2:
        parser.error(f"--pairs {given.pairs}: an interval needs at least 2.")
    trees = (given.old.resolve(), given.new.resolve())
    for tree in trees:
        check(tree)
    give(compare(trees, given.bench, given.pairs, given.seconds, options), given.out)


if __name__ == "__main__":
    main()
