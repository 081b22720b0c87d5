"""Means over realities: the intervals hold the truth as often as they say, and runs of one reality are one unit."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import stats

from hts.errors import EvaluationError
from hts.evaluation.population import paired, population, quantile, spread


def drawn(rng, realities, seeds, between, within, mean=0.2):
    """reality -> seeds, with these standard deviations."""
    shared = mean + between * rng.standard_normal(realities)
    return {f"r{index}": (one + within * rng.standard_normal(seeds)).tolist() for index, one in enumerate(shared)}


def coverage(trials, truth, interval_of):
    """Share of `trials` intervals that hold the truth."""
    found = [interval_of(trial) for trial in range(trials)]
    return np.mean([low <= truth <= high for low, high in found])


@pytest.mark.parametrize(
    ("realities", "seeds", "between", "within"),
    [(6, 2, 0.05, 0.02), (8, 1, 0.05, 0.02), (8, 5, 0.01, 0.05), (16, 2, 0.05, 0.05), (32, 1, 0.05, 0.02)],
)
def test_the_interval_of_the_mean_holds_the_truth_as_often_as_it_says(realities, seeds, between, within):
    rng = np.random.default_rng(0)

    def one(trial):
        values = drawn(rng, realities, seeds, between, within)
        return population(values, resamples=800, seed=trial).interval

    assert 0.92 <= coverage(500, 0.2, one) <= 0.975


def test_taking_runs_for_units_would_be_overconfident():
    rng = np.random.default_rng(0)

    def one(trial):
        runs = np.concatenate(list(drawn(rng, 8, 5, 0.05, 0.02).values()))
        reach = stats.t.isf(0.025, len(runs) - 1) * runs.std(ddof=1) / math.sqrt(len(runs))
        return runs.mean() - reach, runs.mean() + reach

    assert coverage(400, 0.2, one) < 0.75


@pytest.mark.parametrize("realities", [16, 32])
def test_the_interval_of_the_median_holds_the_truth_too(realities):
    rng = np.random.default_rng(0)

    def one(trial):
        return population(drawn(rng, realities, 1, 0.05, 0.02), quantile(0.5), resamples=800, seed=trial).interval

    assert 0.92 <= coverage(400, 0.2, one) <= 0.99


def test_what_a_reality_does_to_both_methods_cancels_in_pairs():
    rng, widths = np.random.default_rng(0), []

    def one(trial):
        shared = 0.2 + 0.2 * rng.standard_normal(8)
        ours, other = (
            {f"r{index}": (value + gain + 0.01 * rng.standard_normal(2)).tolist() for index, value in enumerate(shared)}
            for gain in (0.03, 0.0)
        )
        low, high = paired(ours, other, resamples=800, seed=trial).interval
        widths.append(high - low)
        return low, high

    assert 0.92 <= coverage(400, 0.03, one) <= 0.975
    assert np.mean(widths) < 0.05  # unpaired it would be 0.3


def test_each_reality_counts_the_same_and_sessions_are_averaged():
    found = population({"a": [0.1, 0.3], "b": [0.4], "c": [[0.5, 0.7]]})
    assert found.estimate == pytest.approx((0.2 + 0.4 + 0.6) / 3)
    assert (found.realities, found.runs) == (3, 4)


def test_one_reality_gives_no_interval_and_the_same_seed_the_same_one():
    assert population({"a": [0.1, 0.2, 0.3]}).interval is None
    values = {"a": [0.1], "b": [0.2], "c": [0.4]}
    assert population(values, seed=3).interval == population(values, seed=3).interval


def test_the_spread_is_parted_into_realities_and_seeds():
    # means 2 and 6: variance 8; within: squares 2 and 2 over 2 degrees of freedom: 2; 8 - 2/2 = 7
    found = spread({"a": [1.0, 3.0], "b": [5.0, 7.0]})
    assert (found.between, found.within) == (pytest.approx(7**0.5), pytest.approx(2**0.5))
    assert spread({"a": [1.0], "b": [5.0]}).within is None
    assert spread({"a": [0.0, 10.0], "b": [5.0, 5.0]}).between == 0.0


def test_only_realities_of_both_are_compared_and_none_in_common_is_one_line():
    found = paired({"a": [0.3], "b": [0.5], "c": [9.0]}, {"b": [0.1], "a": [0.1]})
    assert found.estimate == pytest.approx(0.3)
    assert found.realities == 2
    with pytest.raises(EvaluationError, match="Nothing to pair: the first has runs on a, the second on b"):
        paired({"a": [0.3]}, {"b": [0.1]})


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({}, "no reality"),
        ({"a": []}, "'a' has no run"),
        ({"a": [0.1], "b": [math.nan]}, "'b' has a number that is not"),
    ],
)
def test_a_bad_number_is_one_line(values, said):
    with pytest.raises(EvaluationError, match=said):
        population(values)


def test_one_reality_has_no_spread_between_realities():
    with pytest.raises(EvaluationError, match="Run on another one too"):
        spread({"a": [0.1, 0.2]})
