"""The sweep of Algorithm 1: anchors x weights x bounds, and nothing twice."""

from __future__ import annotations

import math

from hts.ppo.sweep import candidates


def test_the_sweep_of_the_paper_has_18_candidates_and_9_while_best_is_pretrained():
    weights, bounds = {"cost": (0.5, 1.0, 5.0)}, (0.2, 0.5, 1.0)
    later = candidates(1, {"best": "b", "pretrained": "a"}, weights, bounds)
    first = candidates(0, {"best": "a", "pretrained": "a"}, weights, bounds)
    assert len(later) == 2 * 3 * 3
    assert len(first) == 3 * 3
    assert {candidate.anchor for candidate in first} == {"best"}
    assert len({(c.anchor, c.weights["cost"], c.kl_bound) for c in later}) == 18


def test_ids_count_within_the_iteration_in_the_order_anchors_weights_bounds():
    made = candidates(3, {"best": "b", "pretrained": "a"}, {"cost": (1.0, 5.0)}, (0.5, math.inf))
    assert [candidate.id for candidate in made] == [f"03-{index:02d}" for index in range(8)]
    assert [(c.anchor, c.weights["cost"], c.kl_bound) for c in made[:3]] == [
        ("best", 1.0, 0.5),
        ("best", 1.0, math.inf),
        ("best", 5.0, 0.5),
    ]
    assert made[4].anchor == "pretrained"


def test_two_objectives_give_every_pair_of_weights():
    made = candidates(0, {"pretrained": "a"}, {"calm": (1.0, 2.0), "quiet": (3.0, 4.0)}, (0.5,))
    assert [dict(candidate.weights) for candidate in made] == [
        {"calm": 1.0, "quiet": 3.0},
        {"calm": 1.0, "quiet": 4.0},
        {"calm": 2.0, "quiet": 3.0},
        {"calm": 2.0, "quiet": 4.0},
    ]
