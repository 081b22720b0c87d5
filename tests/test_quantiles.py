"""Quantiles against printed tables: NIST/SEMATECH e-Handbook of Statistical Methods, 1.3.6.7."""

import math

import numpy as np
import pytest

from hts.quantiles import normal_quantile, student_quantile, weighted_quantiles


@pytest.mark.parametrize(
    ("probability", "degrees", "printed"),
    [(0.975, 1, 12.706), (0.975, 3, 3.182), (0.975, 10, 2.228), (0.95, 5, 2.015), (0.025, 10, -2.228)],
)
def test_students_quantiles_are_those_of_the_tables(probability, degrees, printed):
    assert student_quantile(probability, degrees) == pytest.approx(printed, abs=5e-4)


def test_the_normals_quantiles_are_those_of_the_tables():
    assert [round(normal_quantile(one), 3) for one in (0.5, 0.95, 0.975)] == [0.0, 1.645, 1.96]
    assert student_quantile(0.975, math.inf) == pytest.approx(normal_quantile(0.975), abs=1e-12)


def test_weighted_quantiles_count_a_value_as_often_as_its_share():
    values, shares = np.array([3.0, 1.0, 2.0]), np.array([0.25, 0.5, 0.25])
    # cumulated from the middle of each: 1 at 0.25, 2 at 0.625, 3 at 0.875; beyond the ends the ends
    assert weighted_quantiles(values, shares, (0.1, 0.25, 0.625, 0.75, 0.99)) == pytest.approx([1, 1, 2, 2.5, 3])
