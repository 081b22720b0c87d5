"""The scripts behind the tables of docs/evaluation.md that say where an error or an interval is not as stated."""

from __future__ import annotations

import pytest
from racing import dropped


@pytest.mark.parametrize(
    ("own", "anytime", "least", "most"),
    [(0.0, False, 0.0, 0.05), (2.0, False, 0.2, 0.5), (0.0, True, 0.0, 0.05), (4.0, True, 0.07, 0.3)],
)
def test_a_session_of_its_own_drops_the_best_more_often_than_stated(own, anytime, least, most):
    """Six equal candidates, of which one leads by chance; 150 races."""
    level = 0.05 / 6 if anytime else 0.05 / (4 * 6)
    assert least <= dropped(150, 6, level, own=own, anytime=anytime) <= most
