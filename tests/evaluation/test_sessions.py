"""Intervals over sessions, on worlds whose sessions scatter and whose answer is known."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from hts.config import EvaluationConfig
from hts.evaluation.head_to_head import compare
from hts.evaluation.sessions import over_sessions
from hts.recordings.recording import Recording
from hts.testing.made_up_recordings import CostObjective, known_head_to_head

OBJECTIVE = CostObjective()
QUICK = EvaluationConfig(bootstrap=200)


def saving(policy: np.ndarray, reference: np.ndarray) -> float:
    return float(1 - policy[0] / reference[0])


def sessions(count: int, scatter: float, seed: int, noise: float = 0.03) -> list[Recording]:
    """Head-to-heads of an 8 against a 10; what a policy costs in a session is off by a share of that, sigma `scatter`,
    in all of the session's blocks."""
    rng = np.random.default_rng(seed)
    found = []
    for number in range(count):
        costs = np.array([8.0, 10.0]) * (1 + scatter * rng.standard_normal(2))
        own = known_head_to_head(*costs, block_seconds=8, scatter=noise, correlation=0.3, seed=int(rng.integers(2**31)))
        found += [recording.replace(session=f"day {number}") for recording in own]
    return found


def holds(count: int, scatter: float, worlds: int, as_one: bool = False, truth: float = 0.2) -> float:
    """Share of evaluations whose interval holds the truth. as_one: as if all blocks were of one session."""
    hits = 0
    for seed in range(worlds):
        recordings = sessions(count, scatter, seed)
        if as_one:
            recordings = [r.replace(session="one", block=number) for number, r in enumerate(recordings)]
        low, high = compare(OBJECTIVE, recordings, QUICK, seed).improvement_ci95
        hits += low <= truth <= high
    return hits / worlds


def test_of_a_mean_it_is_students_interval():
    """The difference of two means is linear, so pseudo-values are the sessions' own differences: 1, 2 and 6."""
    policy, reference = np.array([[3.0], [5.0], [8.0]]), np.array([[2.0], [3.0], [2.0]])
    low, high = over_sessions(lambda a, b: float(a[0] - b[0]), policy, reference)
    half = stats.t.ppf(0.975, 2) * np.std([1, 2, 6], ddof=1) / np.sqrt(3)
    assert (low, high) == pytest.approx((3 - half, 3 + half))


def test_of_a_saving_it_is_nearly_that_of_the_sessions_own_savings():
    rng = np.random.default_rng(0)
    policy, reference = (cost * (1 + 0.02 * rng.standard_normal((6, 1))) for cost in (8, 10))
    low, high = over_sessions(saving, policy, reference)
    own = [saving(p, r) for p, r in zip(policy, reference, strict=True)]
    half = stats.t.ppf(0.975, 5) * np.std(own, ddof=1) / np.sqrt(6)
    assert (high - low) / 2 == pytest.approx(half, rel=0.02)
    assert (high + low) / 2 == pytest.approx(np.mean(own), abs=0.02 * half)


def test_without_a_session_that_cannot_be_left_out_there_is_no_interval():
    def log_of(policy: np.ndarray, reference: np.ndarray) -> float:
        return float(np.log(policy[0])) if policy[0] > 0 else float("nan")

    assert over_sessions(log_of, np.array([[3.0], [-1.0]]), np.ones((2, 1))) is None


def test_a_session_of_one_role_alone_counts_for_nothing():
    """On the fourth day no second of the policy counts, and the reference is dear: it is in nobody's mean."""
    recordings = []
    for number, (mine, other) in enumerate([(8.0, 10.0), (8.1, 10.1), (7.9, 9.9), (8.0, 14.0)]):
        own = known_head_to_head(mine, other, block_seconds=8, scatter=0.01, correlation=0.3, seed=number)
        kept = [one for one in own if number < 3 or one.role == "reference"]
        recordings += [one.replace(session=f"day {number}") for one in kept]
    found = compare(OBJECTIVE, recordings, QUICK, 0)
    low, high = found.improvement_ci95
    assert found.comparison.improvement == pytest.approx(0.2, abs=0.01)
    assert (low + high) / 2 == pytest.approx(found.comparison.improvement, abs=1e-3) and high - low < 0.1


def test_an_evaluation_over_sessions_holds_the_truth_nineteen_times_in_twenty():
    # 400 evaluations: the standard deviation of this share is 1.1 %
    assert 0.92 <= holds(4, scatter=0.01, worlds=400) <= 0.98


def test_blocks_alone_would_not_because_sessions_scatter():
    assert holds(4, scatter=0.03, worlds=100, as_one=True) < 0.7
    assert holds(4, scatter=0.03, worlds=100) > 0.9


def test_one_session_has_the_interval_that_it_always_had():
    (one,) = [compare(OBJECTIVE, known_head_to_head(8.0, 10.0, scatter=0.05), QUICK)]
    named = [r.replace(session="a day") for r in known_head_to_head(8.0, 10.0, scatter=0.05)]
    assert compare(OBJECTIVE, named, QUICK).improvement_ci95 == one.improvement_ci95


def test_metrics_have_intervals_over_sessions_too():
    found = compare(OBJECTIVE, sessions(3, 0.01, 1), QUICK)
    assert found.metrics_ci95["gross_reduction"] == pytest.approx(found.improvement_ci95)  # nothing idles here
