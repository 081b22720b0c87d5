"""A 95 % interval for a comparison that was made in several sessions: then the sessions are the units.

Sessions of one machine differ in more than a block shows: the held command is found anew by a noisy speed sensor,
charge, air and floor are others, motors were warmed up by another walk. What a whole session has in common does not
average out within it, so the interval of one head-to-head (`hts.evaluation.intervals`) is too narrow for "this policy
on this machine". With sessions s = 1 … S and θ(·) the comparison of means over the pieces of the given sessions,

    θ_s = S θ(all) − (S − 1) θ(all but s),   θ(all) ± t_{S−1} · sd(θ_s) / √S

are the pseudo-values of the jackknife and Tukey's interval (Tukey 1958, Annals of Mathematical Statistics 29:614;
Miller 1974, Biometrika 61:1). For a statistic that is nearly linear in the means, as a saving is, θ_s is what session s
alone found, and the interval is Student's for S normal sessions: exact for small S, wide for two.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from scipy import stats

from hts.evaluation.intervals import interval
from hts.evaluation.segments import Segments

Statistic = Callable[[np.ndarray, np.ndarray], float]


def interval_of(
    statistic: Statistic,
    policy: tuple[Segments, np.ndarray],
    reference: tuple[Segments, np.ndarray],
    resamples: int = 2000,
    seed: int = 0,
    level: float = 0.95,
) -> tuple[float, float] | None:
    """Interval of `statistic(policy mean, reference mean)`, each mean of shape (Q,).

    policy, reference: their segments and a table (S, Q) of quantities. Over sessions, where at least two hold segments
    of both; else over the blocks of the one session. A session that holds segments of one of them alone counts too: it
    is in the means, and left out of the interval its middle would not be the number that is reported. None where a
    single segment leaves nothing to tell it from.
    """
    named = [_by_session(*one) for one in (policy, reference)]
    common = [name for name in named[0] if name in named[1]]
    if len(common) > 1:
        every = dict.fromkeys((*named[0], *named[1]))
        first, second = (
            [found.get(name, table[:0]) for name in every]
            for found, (_, table) in zip(named, (policy, reference), strict=True)
        )
        return over_sessions(statistic, first, second, level)
    blocks = [
        [table[found.block == number] for number in np.unique(found.block)] for found, table in (policy, reference)
    ]
    return interval(statistic, blocks[0], blocks[1], resamples, seed, level)


def over_sessions(
    statistic: Statistic, policy: Sequence[np.ndarray], reference: Sequence[np.ndarray], level: float = 0.95
) -> tuple[float, float]:
    """Tukey's interval; policy, reference: one array (segments, Q) per session, two sessions at least of each with
    segments."""
    count = len(policy)
    sums = [np.array([one.sum(axis=0) for one in role]) for role in (policy, reference)]  # (S, Q)
    sizes = [np.array([len(one) for one in role], dtype=float) for role in (policy, reference)]

    def theta(kept: np.ndarray) -> float:
        means = [total[kept].sum(axis=0) / size[kept].sum() for total, size in zip(sums, sizes, strict=True)]
        return statistic(means[0], means[1])

    everybody = np.ones(count, dtype=bool)
    whole = theta(everybody)
    without = np.array([theta(everybody & (np.arange(count) != left_out)) for left_out in range(count)])
    pseudo = count * whole - (count - 1) * without
    half = float(stats.t.ppf((1 + level) / 2, count - 1) * pseudo.std(ddof=1) / np.sqrt(count))
    return whole - half, whole + half


def _by_session(segments: Segments, table: np.ndarray) -> dict[str, np.ndarray]:
    """Rows of each session that has any, in the order of the recordings."""
    names = [segments.recordings[index].session for index in segments.recording]
    rows: dict[str, list[int]] = {}
    for row, name in enumerate(names):
        rows.setdefault(name, []).append(row)
    return {name: table[chosen] for name, chosen in rows.items()}
