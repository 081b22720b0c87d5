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

DRAWS = 20_000  # of each pair's sessions
DEGREES = 8
"""Of a session's own interval where each of its four short blocks is cut into three batches: 12 less 4."""


@dataclass(frozen=True)
class Drawn:
    """Shares of intervals that lie above or below the mean of the pair's sessions, over pairs, each alike."""

    above: float
    below: float
    pairs: int


def student_of_sessions(evaluations: Iterable[CoverageLine]) -> Drawn | None:
    """95 % intervals of S sessions drawn with replacement from all of a pair's at one speed, S being what an
    evaluation of it has. Sessions that tell no figure of their own, their speeds having ended apart, are not among
    them. None where no pair has LEAST sessions."""
    pools: dict[tuple[tuple[str, ...], str, int], list[float]] = {}
    for line in evaluations:
        for speed, found in line.speeds.items():
            pool = pools.setdefault((line.pair, speed, line.lengths.sessions), [])
            pool.extend(one.improvement for one in found.occasions)
    random = np.random.default_rng(0)
    sides = []
    for (_, _, count), pool in sorted(pools.items()):
        if len(pool) < LEAST or count < 2:
            continue
        drawn = random.choice(np.array(pool), (DRAWS, count))
        error = drawn.mean(axis=1) - np.mean(pool)
        half = stats.t.ppf(0.975, count - 1) * drawn.std(axis=1, ddof=1) / np.sqrt(count)
        sides.append((float((error > half).mean()), float((error < -half).mean())))
    if not sides:
        return None
    above, below = np.mean(sides, axis=0)
    return Drawn(above=float(above), below=float(below), pairs=len(sides))


@dataclass(frozen=True)
class OwnOfSessions:
    """Quartiles over pairs of policy and reality of what a session has of its own, in standard deviations of a half
    (one block of the policy and one of the reference), and of both in the unit of the objective."""

    pairs: int
    sessions: int
    own: tuple[float, ...]
    half: tuple[float, ...]
    ratio: tuple[float, ...]


def own_of_sessions(evaluations: Iterable[CoverageLine]) -> OwnOfSessions | None:
    """By how much sessions of A-B-B-A scatter beyond what their own blocks show: own² = Var(session) − mean(se²), with
    se = half width / t of the session's own interval, and a half has the variance 2 se², since a session is two.

    Of the difference from the reference, so what a session has of its own for the reference is in it too. None where no
    pair has LEAST sessions with an interval.
    """
    pools: dict[tuple[tuple[str, ...], str], list[tuple[float, float]]] = {}
    for line in evaluations:
        for speed, found in line.speeds.items():
            pool = pools.setdefault((line.pair, speed), [])
            told = [(one.improvement, one.improvement_ci95) for one in found.occasions]
            pool.extend((value, (ci[1] - ci[0]) / 2 / stats.t.ppf(0.975, DEGREES)) for value, ci in told if ci)
    rows, sessions = [], 0
    for _, pool in sorted(pools.items()):
        if len(pool) < LEAST:
            continue
        values, errors = np.array(pool).T
        own, half = np.sqrt(max(0.0, values.var(ddof=1) - (errors**2).mean())), np.sqrt(2 * (errors**2).mean())
        rows.append((own, half, own / half))
        sessions += len(pool)
    if not rows:
        return None
    own, half, ratio = (tuple(map(float, one)) for one in np.quantile(rows, (0.25, 0.5, 0.75), axis=0).T)
    return OwnOfSessions(len(rows), sessions, own, half, ratio)
