"""Quantiles against printed tables: NIST/SEMATECH e-Handbook of Statistical Methods, 1.3.6.7."""

import math

import pytest

from hts.quantiles import normal_quantile, student_quantile


@pytest.mark.parametrize(
    ("probability", "degrees", "printed"),
    [(0.975, 1, 12.706), (0.975, 3, 3.182), (0.975, 10, 2.228), (0.95, 5, 2.015), (0.025, 10, -2.228)],
)
def test_students_quantiles_are_those_of_the_tables(probability, degrees, printed):
    assert student_quantile(probability, degrees) == pytest.approx(printed, abs=5e-4)


def test_the_normals_quantiles_are_those_of_the_tables():
    assert [round(normal_quantile(one), 3) for one in (0.5, 0.95, 0.975)] == [0.0, 1.645, 1.96]
    assert student_quantile(0.975, math.inf) == pytest.approx(normal_quantile(0.975), abs=1e-12)
