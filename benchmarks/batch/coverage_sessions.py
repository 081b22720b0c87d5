"""What Student's interval can hold: of sessions that are as they are, with nothing else that could be wrong.

An evaluation's interval is Student's for sessions that are normal (`hts.evaluation.sessions`). They are not: a session
on a slope or with a low battery is another kind of session, not a little more noise. Four of them that happen to lack
the rare kind have a mean that is off and, for the same reason, an interval that is too narrow, and if the rare kind
saves less, the misses lie above (Bartlett 1935, Proceedings of the Cambridge Philosophical Society 31:223, on skewness
and Student's t). Drawn from the sessions that were seen, that share of the misses can be told from all others: truth,
instruments and the choice of seconds play no part in it.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy import stats

if TYPE_CHECKING:
    from batch.coverage_lines import CoverageLine

LEAST = 40
"""Sessions of a pair below which their spread is not known well enough to draw from."""


@dataclass(frozen=True)
class Drawn:
    """Shares of intervals that lie above or below the mean of the pair's sessions, over pairs, each alike."""

    above: float
    below: float
    pairs: int


def student_of_sessions(evaluations: Iterable[CoverageLine], draws: int = 20_000, seed: int = 0) -> Drawn | None:
    """95 % intervals of S sessions drawn with replacement from all of a pair's at one speed, S being what an
    evaluation of it has. Sessions that tell no figure of their own, their speeds having ended apart, are not among
    them. None where no pair has LEAST sessions."""
    pools: dict[tuple[tuple[str, ...], str, int], list[float]] = {}
    for line in evaluations:
        for speed, found in line.speeds.items():
            pool = pools.setdefault((line.pair, speed, line.lengths.sessions), [])
            pool.extend(one.improvement for one in found.occasions)
    random = np.random.default_rng(seed)
    sides = []
    for (_, _, count), pool in sorted(pools.items()):
        if len(pool) < LEAST or count < 2:
            continue
        drawn = random.choice(np.array(pool), (draws, count))
        error = drawn.mean(axis=1) - np.mean(pool)
        half = stats.t.ppf(0.975, count - 1) * drawn.std(axis=1, ddof=1) / np.sqrt(count)
        sides.append((float((error > half).mean()), float((error < -half).mean())))
    if not sides:
        return None
    above, below = np.mean(sides, axis=0)
    return Drawn(above=float(above), below=float(below), pairs=len(sides))
