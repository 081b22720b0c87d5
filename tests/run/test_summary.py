"""The pooled rank correlation of summary.json."""

from __future__ import annotations

import pytest

from hts.run.summary import _model as of_model
from hts.run.summary import pooled_ranks


def check(measured, predicted, proxy, speed=0.8):
    def rows(values):
        return [{"speed": speed, "measured": m, "predicted": p} for m, p in zip(measured, values, strict=True)]

    return {"policies": rows(predicted), "proxy": {"plain": {"policies": rows(proxy)}}}


def test_ranks_are_pooled_over_iterations_so_that_a_level_that_moves_between_fits_counts():
    # Each iteration alone is ordered perfectly by both; together the proxy's second fit lies far too high.
    ranks = pooled_ranks([check([3.0, 4.0], [3.1, 4.2], [3.0, 4.0]), check([1.0, 2.0], [0.9, 2.2], [8.0, 9.0])])
    assert ranks["policies"] == 4
    assert ranks["rank_correlation"] == pytest.approx(1.0)
    # measured ranks 3 4 1 2, proxy ranks 1 2 3 4: d = 2 2 2 2, rho = 1 - 6 * 16 / (4 * 15) = -0.6
    assert ranks["proxy_rank_correlation"]["plain"] == pytest.approx(-0.6)


def test_costs_at_another_speed_are_not_ranked_with_the_others():
    """At 0.5 m/s everything costs less: ranked with those at 0.8 it would look as if costs had been foreseen."""
    slower = check([1.0, 1.1], [1.1, 1.0], [1.0, 1.1], speed=0.5)
    ranks = pooled_ranks([slower, check([3.0, 4.0, 5.0], [5.0, 4.0, 3.0], [3.0, 4.0, 5.0])])
    assert ranks["policies"] == 3 and ranks["rank_correlation"] == pytest.approx(-1.0)
    assert ranks["proxy_rank_correlation"]["plain"] == pytest.approx(1.0)
    assert pooled_ranks([])["rank_correlation"] is None


def test_one_policy_has_no_rank():
    assert pooled_ranks([check([3.0], [3.1], [2.9])])["rank_correlation"] is None


def test_a_session_on_both_sides_stands_beside_held_out_r2_and_nothing_does_without():
    report = {"dataset": "d", "held_out_r2": 0.9, "rank_correlation": None, "held_out": {}}
    shared = {"held_out": 1, "of": 2}
    assert of_model({**report, "same_session": shared}, None)["same_session"] == shared
    assert "same_session" not in of_model({**report, "same_session": {"held_out": 0, "of": 2}}, None)
    assert "same_session" not in of_model(report, None)  # of an earlier version
