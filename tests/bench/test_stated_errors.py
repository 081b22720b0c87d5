"""The scripts behind the tables of docs/evaluation.md that say where an error or an interval is not as stated."""

from __future__ import annotations

import pytest
from intervals import held_by_blocks, held_by_realities, normal, skewed
from racing_errors import dropped

from hts.evaluation.population import mean, quantile


@pytest.mark.parametrize(
    ("unit", "own", "test", "least", "most"),
    [
        ("half", 0.0, "looks", 0.0, 0.05),
        ("half", 2.0, "looks", 0.2, 0.5),
        ("half", 0.0, "anytime", 0.0, 0.05),
        ("half", 4.0, "anytime", 0.07, 0.3),
        ("round", 0.0, "looks", 0.0, 0.05),
        ("round", 2.0, "looks", 0.0, 0.05),
        ("round", 0.0, "anytime", 0.0, 0.05),
        ("round", 4.0, "anytime", 0.0, 0.05),
    ],
)
def test_a_session_of_its_own_is_in_the_error_of_rounds_and_not_of_halves(unit, own, test, least, most):
    """Six equal candidates, of which one leads by chance; 150 races."""
    assert least <= dropped(150, 6, own=own, test=test, unit=unit) <= most


def test_a_session_of_its_own_for_one_alone_is_not_in_the_error_of_pooled_scatter():
    assert dropped(300, 6, own=4.0, alone=True) > 0.05 >= dropped(150, 6, own=4.0, alone=True, test="anytime")


@pytest.mark.parametrize(
    ("correlations", "least", "most"), [((0.8, 0.8), 0.92, 0.98), ((0.8, 0.0), 0.80, 0.92), ((0.0, 0.0), 0.92, 0.98)]
)
def test_one_correlation_for_both_is_too_narrow_where_only_one_wanders(correlations, least, most):
    assert least <= held_by_blocks(300, 78, correlations, (5.0, 5.0), resamples=300) <= most


def test_what_a_whole_block_has_of_its_own_is_not_in_the_interval_of_one_session():
    assert held_by_blocks(300, 78, (0.6, 0.6), (5.0, 5.0), resamples=300, own=2.0) < 0.8


@pytest.mark.parametrize(
    ("statistic", "draw", "count", "least", "most"),
    [
        (mean, normal, 4, 0.91, 0.98),
        (mean, skewed, 4, 0.84, 0.92),
        (quantile(0.5), normal, 3, 0.87, 0.94),
        (quantile(0.5), normal, 4, 0.92, 0.99),
    ],
)
def test_few_realities_hold_the_truth_as_often_as_the_page_says(statistic, draw, count, least, most):
    assert least <= held_by_realities(400, count, statistic, draw, resamples=400) <= most
