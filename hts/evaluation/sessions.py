"""A 95 % interval for a comparison that was made in several sessions: then the sessions are the units.

Sessions of one machine differ in more than a block shows: the held command is found anew by a noisy speed sensor,
charge, air and floor are others, motors were warmed up by another walk. What a whole session has in common does not
average out within it, so the interval of one head-to-head (`hts.evaluation.intervals`) is too narrow for "this policy
on this machine". With sessions s = 1 … S and θ(·) the comparison of the means over the given sessions, in which every
session counts the same,

    θ_s = S θ(all) − (S − 1) θ(all but s),   θ(all) ± t_{S−1} · sd(θ_s) / √S

are the pseudo-values of the jackknife and Tukey's interval (Tukey 1958, Annals of Mathematical Statistics 29:614;
Miller 1974, Biometrika 61:1). For a statistic that is nearly linear in the means, as a saving is, θ_s is what session s
alone found, and the interval is Student's for S normal sessions: exact for small S, wide for two.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from hts.evaluation.balance import Balance
from hts.evaluation.intervals import LEVEL, interval
from hts.quantiles import student_quantile

Statistic = Callable[[np.ndarray, np.ndarray], float]


def interval_of(
    statistic: Statistic, balance: Balance, policy: np.ndarray, reference: np.ndarray, resamples: int, seed: int = 0
) -> tuple[float, float] | None:
    """Interval of `statistic(policy mean, reference mean)`, each mean of shape (Q,), as `balance.means` makes them.

    policy, reference: tables (S, Q) of quantities, a row for each segment. Over sessions, where at least two hold
    segments of both; else over blocks. None where a single segment leaves nothing to tell it from, or where the
    comparison of a draw is no finite number.
    """
    if balance.sessions:
        return over_sessions(statistic, *balance.session_means(policy, reference))
    blocks = [
        [table[rows] for rows in role[0]] for role, table in ((balance.policy, policy), (balance.reference, reference))
    ]
    return interval(statistic, blocks[0], blocks[1], resamples, seed)


def over_sessions(statistic: Statistic, policy: np.ndarray, reference: np.ndarray) -> tuple[float, float] | None:
    """Tukey's interval; policy, reference: means of each session, (S, Q), of two sessions at least. None where the
    comparison without one of them is no finite number."""
    count = len(policy)

    def theta(kept: np.ndarray) -> float:
        return statistic(policy[kept].mean(axis=0), reference[kept].mean(axis=0))

    everybody = np.ones(count, dtype=bool)
    whole = theta(everybody)
    without = np.array([theta(everybody & (np.arange(count) != left_out)) for left_out in range(count)])
    if not np.isfinite(without).all():
        return None
    pseudo = count * whole - (count - 1) * without
    half = float(student_quantile((1 + LEVEL) / 2, count - 1) * pseudo.std(ddof=1) / np.sqrt(count))
    return whole - half, whole + half
