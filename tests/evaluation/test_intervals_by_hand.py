"""The parts of an interval, against numbers that can be worked on paper."""

from __future__ import annotations

import numpy as np
import pytest

from hts.evaluation.intervals import (
    _batch,
    _degrees,
    _joined_if_single,
    _variance_ratio,
    interval,
    lag_one_correlation,
    variance_of_mean,
)


@pytest.mark.parametrize(
    ("segments", "correlation", "sizes"),
    [
        (40, 0.0, [5] * 8),  # batches have five segments where neighbours are not alike
        (39, 0.0, [6, 6, 6, 6, 5, 5, 5]),  # 39 / 5 = 7.8, so seven
        (14, 0.0, [5, 5, 4]),  # three at least
        (2, 0.0, [1, 1]),  # and never more than there are segments
        (100, 0.5, [15, 15, 14, 14, 14, 14, 14]),  # 2 × 0.5 / (1 - 0.25) / 0.1 = 13.3 segments a batch: 7.5
        (100, 0.3, [7] * 10 + [6] * 5),  # 0.6 / 0.91 / 0.1 = 6.6: 15.2
        (40, 0.9, [14, 13, 13]),  # 95 segments would be asked for
    ],
)
def test_batches_are_as_long_as_neighbours_are_alike(segments, correlation, sizes):
    means, found = _batch(np.arange(segments, dtype=float)[:, None], correlation)
    assert found.tolist() == sizes
    ends = np.cumsum(sizes)
    assert means[:, 0].tolist() == pytest.approx([end - (size + 1) / 2 for end, size in zip(ends, sizes, strict=True)])


FIVE, SEVEN = np.array([2.0, -1, -1, -1, 1]), np.array([1.0, 1, 0, -1, -1, 0, 0])
"""Means 0; sums of squares 8 and 4, of products of neighbours -1 and 2."""


def test_the_correlation_of_neighbours_is_as_on_paper():
    # -1/8 · 5/4 = -0.15625, and (5 · -0.15625 + 1) / (5 - 3)
    assert lag_one_correlation([FIVE]) == pytest.approx(0.109375)
    # pooled over a mean length of 6: 1/12 · 6/5 = 0.1, and (6 · 0.1 + 1) / (6 - 3)
    assert lag_one_correlation([FIVE, SEVEN]) == lag_one_correlation([FIVE + 7, SEVEN - 3]) == pytest.approx(1.6 / 3)


def test_the_correlation_lies_between_0_and_095_and_is_that_of_five_segments_and_more():
    assert lag_one_correlation([np.arange(50.0)]) == 0.95
    assert lag_one_correlation([np.tile([1.0, -1.0], 25)]) == 0.0
    four = np.array([1.0, 1.0, -1.0, -1.0])
    assert lag_one_correlation([four]) == 0.0
    assert lag_one_correlation([four, FIVE]) == lag_one_correlation([FIVE])


def test_what_the_bootstrap_shows_too_little_of_is_as_on_paper():
    def ratio(segments, batches, correlation):
        return _variance_ratio([[(np.zeros((batches, 1)), np.full(batches, segments // batches))]], correlation)

    # uncorrelated, 1/m in truth, and (k/m - 1/m) / k shown of k batches: k / (k - 1)
    assert ratio(15, 3, 0.0) == pytest.approx(3 / 2) and ratio(40, 8, 0.0) == pytest.approx(8 / 7)
    # correlation 1/2: V(2) = 3/4; V(4) = (4 + 2 (3/2 + 2/4 + 1/8)) / 16 = 33/64; shown (3/4 - 33/64) / 2 = 15/128
    assert variance_of_mean(4, 0.5) == pytest.approx(33 / 64)
    assert ratio(4, 2, 0.5) == pytest.approx(66 / 15)
    # a block of one batch shows nothing, and is in the truth: (1/4 + 1/4) / 4 of (2/4 - 1/4) / 2 / 4
    both = [[(np.zeros((2, 1)), np.array([2, 2])), (np.zeros((1, 1)), np.array([4]))]]
    assert _variance_ratio(both, 0.0) == pytest.approx(4.0)


def test_degrees_of_freedom_of_unequal_blocks_are_as_on_paper():
    long, short = (np.zeros((3, 1)), np.array([5, 5, 5])), (np.zeros((3, 1)), np.array([2, 2, 2]))
    # variances 1/15 and 1/6 with two degrees each: (7/30)^2 / ((1/225 + 1/36) / 2)
    assert _degrees([[long], [short]], 0.0) == pytest.approx(98 / 29)
    # both of one policy, each a quarter of its variance, beside the long one of the other: 1/60, 1/24 and 1/15
    shares = np.array([1 / 60, 1 / 24, 1 / 15])
    assert _degrees([[long, short], [long]], 0.0) == pytest.approx(shares.sum() ** 2 / (shares**2 / 2).sum())
    alone = (np.zeros((1, 1)), np.array([4]))
    assert _degrees([[long, alone], [short]], 0.0) == pytest.approx((1 / 60 + 1 / 6) ** 2 / ((1 / 3600 + 1 / 36) / 2))
    assert _degrees([[alone], [alone]], 0.0) is None


def test_blocks_of_one_segment_are_joined_where_no_block_has_more():
    one, two = np.array([[1.0]]), np.array([[2.0], [3.0]])
    (joined,) = _joined_if_single([one, one + 4])
    assert joined.tolist() == [[1.0], [5.0]]
    assert [len(block) for block in _joined_if_single([one, two])] == [1, 2]


def test_a_mean_is_that_of_blocks_however_long_they_are():
    """Nothing scatters within them, so the interval is its point: (1 + 3) / 2."""
    policy, reference = [np.ones((10, 1)), np.full((5, 1), 3.0)], [np.zeros((10, 1))] * 2
    assert interval(lambda one, other: float(one[0] - other[0]), policy, reference) == (2.0, 2.0)


def test_a_policy_in_two_blocks_beside_one_in_a_single_block_counts_each_block_by_its_share():
    """Without correlation a mean of n has the variance 1/n, and k batches of m segments show (k/m - 1/m) / k."""
    one, two = ([_batch(np.zeros((length, 1)), 0.0)] * blocks for length, blocks in ((15, 1), (30, 2)))
    assert [len(sizes) for _, sizes in (*one, *two)] == [3, 6, 6]
    # One: 1/15 of which 2/45 show. Two, a quarter each: 1/120 of which 1/144 shows.
    assert _variance_ratio([one, one], 0.0) == pytest.approx(1.5)
    assert _variance_ratio([one, two], 0.0) == pytest.approx((1 / 15 + 2 / 120) / (2 / 45 + 2 / 144))
    # Welch and Satterthwaite: (sum of variances)^2 over the sum of variance^2 / degrees, of 2, 5 and 5.
    assert _degrees([one, two], 0.0) == pytest.approx((1 / 12) ** 2 / (1 / 15**2 / 2 + 2 / 120**2 / 5))
