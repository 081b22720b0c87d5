"""Intervals of one session, on worlds with known answers."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from hts.config import EvaluationConfig
from hts.evaluation.head_to_head import compare
from hts.evaluation.intervals import (
    _batch,
    _degrees,
    interval,
    lag_one_correlation,
    variance_of_mean,
)
from hts.testing.made_up_recordings import CostObjective, known_head_to_head

OBJECTIVE = CostObjective()
QUICK = EvaluationConfig(bootstrap=200)


def saving(policy: np.ndarray, reference: np.ndarray) -> float:
    return float(1 - policy[0] / reference[0])


def coverage(worlds: int, truth: float = 0.2, **world) -> float:
    """Share of simulated head-to-heads of an 8 against a 10 whose interval holds the true saving."""
    hits = 0
    for seed in range(worlds):
        costs = [
            recording.channels["cost"].values[20::10] for recording in known_head_to_head(8.0, 10.0, seed=seed, **world)
        ]
        blocks = [cost[:, None].astype(float) for cost in costs]  # after two seconds of settling, one number a second
        low, high = interval(saving, [blocks[0], blocks[3]], [blocks[1], blocks[2]], resamples=400, seed=seed)
        hits += low <= truth <= high
    return hits / worlds


@pytest.mark.parametrize(
    ("block_seconds", "correlation"), [(20, 0.0), (20, 0.5), (40, 0.6), (80, 0.0), (80, 0.5), (80, 0.8)]
)
def test_the_interval_holds_the_truth_about_nineteen_times_in_twenty(block_seconds, correlation):
    # 300 worlds: the standard deviation of this share is 1.3 %
    share = coverage(300, block_seconds=block_seconds, correlation=correlation, scatter=0.08)
    assert 0.90 <= share <= 0.99


def test_a_drift_does_not_make_the_interval_overconfident():
    # a rise by 1 in all adds 0.5 to both means: 8.5 against 10.5
    share = coverage(200, truth=1 - 8.5 / 10.5, block_seconds=40, correlation=0.5, scatter=0.05, drift=1.0)
    assert share >= 0.90


def test_resampling_single_segments_would_be_overconfident():
    # what the batches are for: were the correlation taken as zero, the interval would hold the truth far too rarely
    hits = 0
    for seed in range(200):
        costs = [
            r.channels["cost"].values[20::10]
            for r in known_head_to_head(8.0, 10.0, seed=seed, scatter=0.08, correlation=0.8)
        ]
        shuffled = [np.random.default_rng(seed).permutation(cost)[:, None].astype(float) for cost in costs]
        low, high = interval(saving, [shuffled[0], shuffled[3]], [shuffled[1], shuffled[2]], resamples=200, seed=seed)
        hits += low <= 0.2 <= high
    assert hits / 200 < 0.75


def test_more_alike_neighbours_give_a_wider_interval():
    widths = []
    for correlation in (0.0, 0.8):
        low, high = compare(
            OBJECTIVE, known_head_to_head(8.0, 10.0, scatter=0.05, correlation=correlation), QUICK
        ).improvement_ci95
        widths.append(high - low)
    assert widths[1] > 1.5 * widths[0]


def test_the_same_seed_gives_the_same_interval_and_another_one_another():
    recordings = known_head_to_head(8.0, 10.0, scatter=0.05)
    first, again, other = (compare(OBJECTIVE, recordings, QUICK, seed).improvement_ci95 for seed in (1, 1, 2))
    assert first == again != other


def test_the_order_in_which_recordings_come_does_not_matter():
    recordings = known_head_to_head(8.0, 10.0, scatter=0.05)
    assert compare(OBJECTIVE, recordings, QUICK).entry() == compare(OBJECTIVE, recordings[::-1], QUICK).entry()


def test_the_variance_of_a_mean_of_neighbours_is_as_on_paper():
    assert variance_of_mean(4, 0.0) == pytest.approx(1 / 4)
    # two neighbours with correlation 1/2: (1 + 1 + 2·1/2) / 4
    assert variance_of_mean(2, 0.5) == pytest.approx(3 / 4)
    # three: (3 + 2·(1/2 + 1/2 + 1/4)) / 9
    assert variance_of_mean(3, 0.5) == pytest.approx(5.5 / 9)


def test_the_lag_one_correlation_of_a_known_series_is_found():
    costs = [
        r.channels["cost"].values[::10]
        for r in known_head_to_head(1.0, 1.0, block_seconds=500, scatter=0.1, correlation=0.6)
    ]
    assert lag_one_correlation(costs) == pytest.approx(0.6, abs=0.05)
    assert lag_one_correlation([np.ones(20)]) == 0.0


def test_one_segment_each_leaves_no_interval():
    one = [np.array([[1.0]])]
    assert interval(saving, one, one) is None


def test_single_segments_of_several_blocks_still_give_one():
    low, high = interval(
        saving, [np.array([[8.0]]), np.array([[8.4]])], [np.array([[10.0]]), np.array([[10.2]])], seed=1
    )
    assert low < 1 - 8.2 / 10.1 < high


@pytest.mark.parametrize("left", [2, 3, 5, 13])
@pytest.mark.parametrize("correlation", [0.0, 0.3])
def test_a_block_with_few_segments_left_counts_as_much_and_makes_it_wide_enough(left, correlation):
    """Two equal policies of 38 and `left` segments, and of 38 and 38; 400 of them: 1.1 % of standard deviation."""
    rng, hits = np.random.default_rng(left), 0
    for seed in range(400):
        policy, reference = ([walk(rng, count, correlation) for count in counts] for counts in ((38, left), (38, 38)))
        low, high = interval(lambda one, other: float(1 - one[0] / other[0]), policy, reference, 200, seed)
        hits += low <= 0 <= high
    assert hits / 400 > 0.91


def walk(rng, count, correlation):
    """An AR(1) series about 1, (count, 1)."""
    found = [rng.standard_normal()]
    for shock in rng.standard_normal(count - 1):
        found.append(correlation * found[-1] + np.sqrt(1 - correlation**2) * shock)
    return 1 + 0.1 * np.array(found)[:, None]


def test_degrees_of_freedom_are_batches_less_blocks_where_all_are_of_one_length():
    blocks = [[_batch(np.random.default_rng(0).random((40, 1)), 0.0)] * 2] * 2
    assert _degrees(blocks, 0.0) == pytest.approx(4 * (len(blocks[0][0][1]) - 1))


def test_what_cannot_be_compared_in_some_draw_has_no_interval():
    few = [np.array([[1.0], [1.0], [1.0], [-2.9], [1.0]])]

    def log_of(policy, reference):
        return float(np.log(policy[0])) if policy[0] > 0 else float("nan")

    assert interval(log_of, few, few, 200) is None
    # Every draw has the mean 0.02, of which a hundredth of the way to -3.9 is no logarithm.
    alike = [np.tile([1.0, 1.0, 1.0, 1.0, -3.9], 3)[:, None]]
    assert interval(log_of, alike, alike, 200) is None


def test_the_interval_is_as_wide_as_its_degrees_of_freedom_say():
    """Two blocks in three batches each: four degrees. All 27 × 27 draws of the bootstrap are listed here."""
    sign = np.tile([1.0, -1.0], 8)[:15]  # neighbours that differ: their correlation counts as none
    policy, reference = (np.repeat(level, 5) + 4 * sign for level in ([7.0, 8.0, 9.6], [9.5, 11.0, 10.2]))
    low, high = interval(difference, [policy[:, None]], [reference[:, None]], resamples=20_000)
    of_batches = [block.reshape(3, 5).mean(axis=1) for block in (policy, reference)]
    means = [[np.mean(drawn) for drawn in product(batches, repeat=3)] for batches in of_batches]
    draws = np.subtract.outer(*means).ravel()
    point = policy.mean() - reference.mean()
    student, normal = 2.776, 1.960  # quantiles for 97.5 %, of printed tables
    expected = (np.quantile(draws, [0.025, 0.975]) - point) * student / normal * np.sqrt(3 / 2)
    assert [low - point, high - point] == pytest.approx(expected, rel=0.03)


def difference(policy: np.ndarray, reference: np.ndarray) -> float:
    return float(policy[0] - reference[0])
