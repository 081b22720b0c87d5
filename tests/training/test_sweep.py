"""The sweep of Algorithm 1: anchors x weights x bounds, and nothing twice."""

from __future__ import annotations

import math

import pytest

from hts.errors import ConfigError
from hts.training.sweep import candidates, combinations


def test_the_sweep_of_the_paper_has_18_candidates_and_9_while_best_is_pretrained():
    weights, bounds = combinations({"cost": (0.5, 1.0, 5.0)}, {}), (0.2, 0.5, 1.0)
    later = candidates(1, {"best": "b", "pretrained": "a"}, weights, bounds)
    first = candidates(0, {"best": "a", "pretrained": "a"}, weights, bounds)
    assert len(later) == 2 * 3 * 3
    assert len(first) == 3 * 3
    assert {candidate.anchor for candidate in first} == {"best"}
    assert len({(c.anchor, c.weights["cost"], c.kl_bound) for c in later}) == 18


def test_ids_count_within_the_iteration_in_the_order_anchors_weights_bounds():
    made = candidates(3, {"best": "b", "pretrained": "a"}, [{"cost": 1.0}, {"cost": 5.0}], (0.5, math.inf))
    assert [candidate.id for candidate in made] == [f"03-{index:02d}" for index in range(8)]
    assert [(c.anchor, c.weights["cost"], c.kl_bound) for c in made[:3]] == [
        ("best", 1.0, 0.5),
        ("best", 1.0, math.inf),
        ("best", 5.0, 0.5),
    ]
    assert made[4].anchor == "pretrained"


def pairs(given=None, calm=(0.5, 1.0), quiet=(3.0, 4.0)):
    return [(one["calm"], one["quiet"]) for one in combinations({"calm": calm, "quiet": quiet}, given or {})]


def test_several_objectives_are_swept_each_alone_and_together_level_by_level():
    assert pairs() == [(0.5, 0), (1.0, 0), (0, 3.0), (0, 4.0), (0.5, 3.0), (1.0, 4.0)]


def test_the_ends_of_several_objectives_are_the_sweeps_of_each_one_alone():
    alone = combinations({"calm": (0.5, 1.0)}, {})
    assert [{"calm": calm} for calm, quiet in pairs() if quiet == 0] == alone


def test_a_shorter_list_is_spread_over_the_levels_of_the_longer_one_and_nothing_comes_twice():
    assert pairs(calm=(2.0,), quiet=(1.0, 2.0, 3.0)) == [(2, 0), (0, 1), (0, 2), (0, 3), (2, 1), (2, 2), (2, 3)]
    assert pairs(calm=(5.0, 1.0), quiet=(1.0, 2.0, 3.0))[5:] == [(1, 1), (1, 2), (5, 3)]


def test_three_objectives_are_swept_alone_in_pairs_and_all_together():
    made = combinations({name: (1.0, 2.0) for name in "abc"}, {})
    assert len(made) == (3 + 3 + 1) * 2
    assert made[0] == {"a": 1.0, "b": 0.0, "c": 0.0} and made[-1] == {"a": 2.0, "b": 2.0, "c": 2.0}


def test_weights_given_for_all_make_every_combination_but_all_zero():
    made = pairs({"calm": (0.0, 1.0, 5.0), "quiet": (0.0, 2.0)})
    assert made == [(0, 2), (1, 0), (1, 2), (5, 0), (5, 2)]


def test_weights_given_for_one_meet_zero_and_the_own_weights_of_the_other():
    assert pairs({"calm": (0.0, 7.0)}) == [(0, 3), (0, 4), (7, 0), (7, 3), (7, 4)]


def test_all_zero_is_never_trained():
    assert combinations({"cost": (1.0,)}, {"cost": (0.0, 2.0)}) == [{"cost": 2.0}]
    with pytest.raises(ConfigError, match="every combination of λ for calm, quiet is zero"):
        pairs({"calm": (0.0,), "quiet": (0.0,)})


def test_an_objective_without_weights_of_its_own_gives_no_candidates():
    assert combinations({"cost": ()}, {}) == []


def test_the_front_is_another_anchor_for_each_combination():
    weights = [{"calm": 1.0, "quiet": 0.0}, {"calm": 0.0, "quiet": 1.0}]
    made = candidates(
        1,
        {"front": "", "pretrained": "p"},
        weights,
        (0.5,),
        lambda w: ("00-02", "c") if w["calm"] else ("pretrained", "p"),
    )
    # the quiet one starts from the pretrained policy already, so the second anchor adds only the calm one
    assert [(one.id, one.anchor, one.weights["calm"]) for one in made] == [
        ("01-00", "00-02", 1.0),
        ("01-01", "pretrained", 0.0),
        ("01-02", "pretrained", 1.0),
    ]
