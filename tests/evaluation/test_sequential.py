"""Confidence sequences: what they claim is true at every look at once, and they end where something is to be seen."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import integrate, stats

from hts.evaluation.sequential import batch_means, confidence_sequence, evidence, half_width


def test_the_evidence_is_the_ratio_of_t_densities_mixed_over_the_effect():
    values = np.array([0.3, 1.1, 0.4, 0.9, -0.2])
    n, g = len(values), 5.0
    t = values.mean() / values.std(ddof=1) * math.sqrt(n)

    def weighted(delta: float) -> float:
        return stats.nct.pdf(t, n - 1, delta * math.sqrt(n)) * stats.norm.pdf(delta, scale=math.sqrt(g))

    mixed, _ = integrate.quad(weighted, -12.0, 12.0, limit=200)
    assert evidence(values, g=g) == pytest.approx(mixed / stats.t.pdf(t, n - 1), rel=1e-5)


def test_the_interval_ends_where_the_evidence_reaches_one_over_alpha():
    values = np.array([1.0, 1.2, 0.9, 1.4, 1.1, 0.8])
    edge = values.mean() + half_width(values, error=0.05)
    assert evidence(values, null=edge) == pytest.approx(20.0)
    assert evidence(values, null=edge - 0.01) < 20.0 < evidence(values, null=edge + 0.01)


def test_neither_unit_nor_sign_matters():
    values = np.array([1.0, 1.2, 0.9, 1.4])
    assert evidence(1000 * values) == pytest.approx(evidence(values))
    assert evidence(-values) == pytest.approx(evidence(values))


def test_two_units_say_nothing_and_equal_ones_everything():
    assert half_width([1.0, 2.0]) == math.inf
    assert evidence([1.0]) == 1.0
    assert evidence([1.0, 1.0, 1.0]) == math.inf
    assert half_width([1.0, 1.0, 1.0, 1.0]) == 0.0


def test_evidence_beyond_what_a_float_holds_is_infinite():
    values = 1.0 + 1e-3 * np.random.default_rng(0).standard_normal(400)
    assert 1e100 < evidence(values[:100]) < math.inf
    assert evidence(values) == math.inf


@pytest.mark.parametrize("wrong", [[1.0, math.nan], [[1.0], [2.0]]])
def test_a_bad_number_never_becomes_another_number(wrong):
    with pytest.raises(ValueError, match="finite|shape"):
        evidence(wrong)


@pytest.mark.parametrize("error", [0.0, 1.0, math.nan])
def test_an_error_is_a_probability(error):
    with pytest.raises(ValueError, match="probability"):
        half_width([1.0, 2.0, 3.0], error)


def test_what_was_excluded_stays_excluded():
    rows = confidence_sequence(np.random.default_rng(0).normal(1.0, 1.0, 40))
    assert np.isinf(rows[1]).all() and np.isfinite(rows[2]).all()
    assert (np.diff(rows[2:, 0]) >= 0).all() and (np.diff(rows[2:, 1]) <= 0).all()


def ever_rejected(units: np.ndarray, rejects) -> float:
    """Share of rows (trials, units) of mean 0 that are found to differ from 0 at any look."""
    return float(np.mean([any(rejects(row[:n]) for n in range(2, len(row) + 1)) for row in units]))


def by_sequence(values: np.ndarray) -> bool:
    return evidence(values) >= 20.0


def by_t_test(values: np.ndarray) -> bool:
    return abs(stats.ttest_1samp(values, 0.0).statistic) > stats.t.isf(0.025, len(values) - 1)


def wandering(rng: np.random.Generator, shape: tuple[int, int], correlation: float) -> np.ndarray:
    """AR(1) series of unit variance, shape (trials, segments)."""
    series = rng.standard_normal(shape)
    for second in range(1, shape[1]):
        series[:, second] = correlation * series[:, second - 1] + math.sqrt(1 - correlation**2) * series[:, second]
    return series


def head_to_heads(rng: np.random.Generator, trials: int, pairs: int, length: int, correlation: float) -> np.ndarray:
    """Equal policies in the order A-B-B-A, one segment a second: differences of neighbouring blocks (trials, pairs)."""
    series = wandering(rng, (trials, 2 * pairs * length), correlation)
    means = np.stack([batch_means(row, length) for row in series]).reshape(trials, pairs, 2)
    sign = np.where(np.arange(pairs) % 2 == 0, 1.0, -1.0)  # A-B, then B-A
    return (means[:, :, 0] - means[:, :, 1]) * sign


def test_stopping_when_it_looks_good_is_wrong_no_more_often_than_stated():
    units = np.random.default_rng(0).standard_normal((1000, 40))
    assert ever_rejected(units, by_sequence) <= 0.05
    assert ever_rejected(units[:150], by_t_test) > 0.2  # what it is for


@pytest.mark.parametrize(
    ("units", "most"),
    [
        pytest.param(lambda rng: rng.standard_t(3, (1000, 30)), 0.05, id="heavy tails"),
        pytest.param(lambda rng: rng.exponential(1.0, (1000, 30, 2)) @ [1, -1], 0.05, id="skewed costs, difference"),
        pytest.param(lambda rng: head_to_heads(rng, 1000, 20, 13, 0.8), 0.05, id="13 s, neighbours 0.8 alike"),
        pytest.param(lambda rng: head_to_heads(rng, 1000, 20, 13, 0.95), 0.08, id="13 s, neighbours 0.95 alike"),
    ],
)
def test_it_holds_where_units_are_not_quite_normal_or_independent(units, most):
    """The last one lies a little above what is stated, as docs/evaluation.md says: blocks are too short for it."""
    assert ever_rejected(units(np.random.default_rng(1)), by_sequence) <= most


def test_one_sided_units_are_beyond_it():
    """What it is not: units that are themselves skewed, which differences of two policies' blocks are not."""
    units = np.random.default_rng(1).exponential(1.0, (1000, 30)) - 1.0
    assert 0.08 < ever_rejected(units, by_sequence) < 0.18


def test_single_seconds_are_no_units():
    """Correlated segments taken as independent would be wrong far more often; their batch means are not."""
    series = wandering(np.random.default_rng(2), (300, 400), 0.8)
    assert ever_rejected(series[:, :120], by_sequence) > 0.15
    assert ever_rejected(np.stack([batch_means(row, 20) for row in series]), by_sequence) <= 0.06


def test_a_clear_difference_is_seen_within_a_few_units():
    rng = np.random.default_rng(3)
    stops = []
    for _ in range(200):
        values = 4.0 + rng.standard_normal(40)
        stops.append(next(n for n in range(3, 41) if by_sequence(values[:n])))
    assert np.median(stops) <= 5
    assert max(stops) <= 10


def test_batch_means_leave_a_short_rest_out():
    assert batch_means(np.array([1.0, 3.0, 5.0, 7.0, 100.0]), 2).tolist() == [2.0, 6.0]
    with pytest.raises(ValueError, match="length is 0"):
        batch_means(np.ones(3), 0)
