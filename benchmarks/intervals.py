"""How often the intervals of `docs/evaluation.md` hold the truth where what they assume is not so, in made-up worlds.

    python benchmarks/intervals.py blocks --worlds 2000        one session whose policy and reference scatter otherwise
    python benchmarks/intervals.py realities --worlds 2000     few realities, or skewed ones

Prints a table. Intervals are those of `hts.evaluation`, stated 95 %. A share of 0.95 of 2000 worlds is known to ± 0.01.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence

import numpy as np

from hts.evaluation.intervals import interval
from hts.evaluation.population import Statistic, mean, population, quantile

SAVING, REFERENCE_WATTS = 0.2, 100.0
BLOCKS: tuple[tuple[int, float, float, float, float], ...] = (
    (78, 0.8, 0.8, 5.0, 5.0),
    (78, 0.8, 0.0, 5.0, 5.0),
    (78, 0.8, 0.0, 8.0, 2.0),
    (78, 0.0, 0.8, 5.0, 5.0),
    (18, 0.8, 0.0, 8.0, 2.0),
    (18, 0.9, 0.9, 5.0, 5.0),
    (38, 0.9, 0.9, 5.0, 5.0),
)
"""Segments a block; correlation of neighbours, and standard deviation in W, of policy and of reference."""
OWN: tuple[tuple[int, float, float, float], ...] = ((78, 0.6, 5.0, 1.0), (78, 0.6, 5.0, 2.0))
"""Segments a block; correlation and standard deviation, W, of both; and standard deviation of whole blocks, W."""

Draw = Callable[[np.random.Generator, int], np.ndarray]


def normal(rng: np.random.Generator, count: int) -> np.ndarray:
    """Realities about 0."""
    return rng.standard_normal(count)


def skewed(rng: np.random.Generator, count: int) -> np.ndarray:
    """Realities with mean 0 of which a few save far less: 1 less an exponential one."""
    return 1.0 - rng.exponential(size=count)


REALITIES: tuple[tuple[str, Statistic, str, Draw, tuple[int, ...]], ...] = (
    ("mean", mean, "normal", normal, (2, 3, 4, 8)),
    ("mean", mean, "skewed", skewed, (2, 3, 4, 8, 32)),
    ("median", quantile(0.5), "normal", normal, (2, 3, 4, 5, 6)),
)


def held_by_blocks(
    worlds: int,
    segments: int,
    correlations: Sequence[float],
    watts: Sequence[float],
    resamples: int = 600,
    own: float = 0.0,
) -> float:
    """Share of head-to-heads of two blocks each whose interval holds the true saving. correlations, watts: of policy
    and reference; own: what each block has of its own, W, as of an idle load that wanders for minutes."""
    rng, hits = np.random.default_rng(0), 0
    levels = (REFERENCE_WATTS * (1 - SAVING), REFERENCE_WATTS)
    for seed in range(worlds):
        policy, reference = (
            [level + scatter * series(rng, segments, correlation) + _of_block(rng, own) for _ in range(2)]
            for level, correlation, scatter in zip(levels, correlations, watts, strict=True)
        )
        found = interval(lambda one, other: float(1 - one[0] / other[0]), policy, reference, resamples, seed)
        assert found is not None
        hits += found[0] <= SAVING <= found[1]
    return hits / worlds


def _of_block(rng: np.random.Generator, own: float) -> float:
    return own * float(rng.standard_normal()) if own else 0.0


def series(rng: np.random.Generator, count: int, correlation: float) -> np.ndarray:
    """(count, 1) of unit variance, neighbours alike by `correlation`."""
    found = [rng.standard_normal()]
    for shock in rng.standard_normal(count - 1):
        found.append(correlation * found[-1] + np.sqrt(1 - correlation**2) * shock)
    return np.array(found)[:, None]


def held_by_realities(worlds: int, count: int, statistic: Statistic, draw: Draw, resamples: int = 2000) -> float:
    """Share of batches of one run on each of `count` realities whose interval holds 0, which is true."""
    rng, hits = np.random.default_rng(0), 0
    for seed in range(worlds):
        values = {str(index): [float(value)] for index, value in enumerate(draw(rng, count))}
        found = population(values, statistic, resamples=resamples, seed=seed).interval
        assert found is not None
        hits += found[0] <= 0.0 <= found[1]
    return hits / worlds


def main() -> int:
    """0."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("blocks", "realities"))
    parser.add_argument("--worlds", type=int, default=2000)
    given = parser.parse_args()
    if given.what == "blocks":
        print("| segments per block | φ of policy, reference | scatter, W | holds |\n|---|---|---|---|")
        for segments, own, other, watts, of_other in BLOCKS:
            share = held_by_blocks(given.worlds, segments, (own, other), (watts, of_other))
            print(f"| {segments} | {own:g}, {other:g} | {watts:g}, {of_other:g} | {share:.3f} |", flush=True)
        print("\n| segments per block | φ | scatter, W | of whole blocks, W | holds |\n|---|---|---|---|---|")
        for segments, own, watts, of_block in OWN:
            share = held_by_blocks(given.worlds, segments, (own, own), (watts, watts), own=of_block)
            print(f"| {segments} | {own:g} | {watts:g} | {of_block:g} | {share:.3f} |", flush=True)
        return 0
    print("| statistic | realities scatter | how many | holds |\n|---|---|---|---|")
    for name, statistic, shape, draw, counts in REALITIES:
        shares = [held_by_realities(given.worlds, count, statistic, draw) for count in counts]
        held = ", ".join(f"{share:.3f}" for share in shares)
        print(f"| {name} | {shape} | {', '.join(map(str, counts))} | {held} |", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
