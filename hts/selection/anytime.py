"""The test of a race by confidence sequences: it may be looked at after every round, however many there are."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from hts.evaluation.sequential import half_width


def still_racing(table: np.ndarray, racing: Sequence[int], error: float, indifference: float) -> list[int]:
    """Rows of `table` that another round is worth, of those in `racing`; the leader alone if it is decided.

    table: score of each candidate in each unit, half or round, (candidates, units), NaN where it was not measured.
    error: of one comparison, over the whole race. indifference: share of the leader's mean score.

    What counts are a pair's differences in the units they share, so what a unit has in common counts for nothing; a
    candidate's own units against the reference. Out is whose sequence lies beyond zero. The best of K candidates
    takes part in K such comparisons (K − 1 others, the reference), so it is ever dropped with probability K · error.
    """
    racing = [row for row in racing if not _below_zero(table[row], error)]
    if len(racing) < 2:
        return racing
    leader = max(racing, key=lambda row: _mean(table[row]))
    pairs = {row: table[leader] - table[row] for row in racing if row != leader}
    behind = {row: (_mean(found), _width(found, error)) for row, found in pairs.items()}
    left = {row: (mean, width) for row, (mean, width) in behind.items() if mean <= width}
    worth = indifference * max(_mean(table[leader]), 0.0)
    if all(width - mean <= worth for mean, width in left.values()):
        return [leader]
    return [row for row in racing if row == leader or row in left]


def _below_zero(values: np.ndarray, error: float) -> bool:
    """Whether a candidate is clearly no better than the reference; of none that was not measured yet."""
    return bool(np.isfinite(values).any()) and _mean(values) + _width(values, error) < 0.0


def _mean(values: np.ndarray) -> float:
    found = values[np.isfinite(values)]
    return float(found.mean()) if len(found) else -math.inf


def _width(values: np.ndarray, error: float) -> float:
    return half_width(values[np.isfinite(values)], error)
