"""The `pareto` selector."""

from __future__ import annotations

import math

import pytest
from pydantic import ValidationError

from hts.contracts import Comparison, SimulatedCandidate
from hts.contracts import TestedCandidate as Elite  # under its own name pytest takes it for a test class
from hts.errors import ConfigError
from hts.plugins import load
from hts.selection import hierarchical
from hts.selection.pareto import make

SELECTOR = make({})


def simulated(name, x, y, falls=0, tracked=True):
    return SimulatedCandidate(name, x + y, falls, tracked, {"x": x, "y": y})


def elite(name, *, fell=False, **scores):
    return Elite(name, {objective: Comparison(score, score) for objective, score in scores.items()}, fell)


FRONT = [simulated("left", 0, 10), simulated("middle", 6, 7), simulated("right", 10, 0)]
BEHIND = [simulated("worse", 5, 6), simulated("worst", 1, 1)]


def test_the_registry_offers_it():
    assert load().selectors["pareto"].package == load().selectors["hierarchical"].package


def test_elites_are_the_front_before_anything_behind_it():
    assert set(SELECTOR.elites([*BEHIND, *FRONT], 3)) == {"left", "middle", "right"}


def test_a_front_too_small_is_followed_by_the_next_one():
    assert SELECTOR.elites([*BEHIND, *FRONT], 4)[3] == "worse"
    assert SELECTOR.elites([*BEHIND, *FRONT], 9)[3:] == ["worse", "worst"]


def test_a_front_too_large_is_covered_from_end_to_end():
    crowd = [simulated(f"near-{i}", 6 + i / 100, 7 - i / 100) for i in range(4)]
    chosen = SELECTOR.elites([*crowd, FRONT[0], FRONT[2]], 3)
    assert {"left", "right"} < set(chosen) and len(chosen) == 3


def test_the_same_walk_twice_is_tested_twice_only_where_nothing_else_is_left():
    again = simulated("again", 10, 0)
    assert SELECTOR.elites([*FRONT, again, *BEHIND], 5) == ["right", "middle", "left", "worse", "worst"]
    assert SELECTOR.elites([*FRONT, again, *BEHIND], 6)[-1] == "again"


def test_one_elite_is_the_compromise():
    assert SELECTOR.elites(FRONT, 1) == ["middle"]


def test_a_candidate_that_falls_or_misses_the_speed_comes_behind_all_others():
    candidates = [simulated("falls", 99, 99, falls=1), simulated("slow", 98, 98, tracked=False), *BEHIND]
    assert SELECTOR.elites(candidates, 4) == ["worse", "worst", "slow", "falls"]


def test_a_score_that_is_not_a_number_comes_last_of_all():
    candidates = [simulated("nan", math.nan, 99), simulated("falls", 0, 0, falls=3), BEHIND[0]]
    assert SELECTOR.elites(candidates, 3) == ["worse", "falls", "nan"]


def test_a_stopped_candidate_with_the_worst_scores_is_an_elite_only_where_nobody_else_is_left():
    stopped = simulated("stopped", -math.inf, -math.inf, tracked=False)
    assert SELECTOR.elites([stopped, *FRONT], 3) == ["right", "middle", "left"]
    assert SELECTOR.elites([stopped, *FRONT], 4)[-1] == "stopped"


def test_with_one_objective_it_chooses_as_hierarchical_does():
    scores = [0.3, -1.0, 2.0, 2.0, math.nan, 1.0]
    candidates = [SimulatedCandidate(str(i), score, int(i == 2), True, {"x": score}) for i, score in enumerate(scores)]
    other = hierarchical.make({})
    for count in range(7):
        assert set(SELECTOR.elites(candidates, count)) == set(other.elites(candidates, count))
    tested = [elite("a", x=0.1), elite("b", x=0.3), elite("c", x=0.2)]
    assert SELECTOR.best(tested) == other.best(tested) == "b"


def test_candidates_without_parts_are_judged_by_their_score():
    candidates = [SimulatedCandidate("a", 1, 0, True), SimulatedCandidate("b", 3, 0, True)]
    assert SELECTOR.elites(candidates, 1) == ["b"]


def test_the_best_is_the_compromise_with_the_largest_product():
    # products: 0.2 * 1 = 0.2, 0.15 * 3 = 0.45, 0.05 * 4 = 0.2
    assert SELECTOR.best([elite("a", x=0.2, y=1), elite("b", x=0.15, y=3), elite("c", x=0.05, y=4)]) == "b"


def test_who_is_worse_than_the_reference_in_one_objective_is_not_the_best():
    assert SELECTOR.best([elite("a", x=0.9, y=-0.1), elite("b", x=0.01, y=0.1)]) == "b"
    assert SELECTOR.best([elite("a", x=0.9, y=-0.1)]) is None
    assert SELECTOR.best([elite("a", x=-0.9, y=-0.9)]) is None
    assert SELECTOR.best([elite("a", x=0.9, y=math.nan)]) is None
    assert SELECTOR.best([]) is None


def test_the_best_goes_by_selection_score_and_not_by_improvement():
    slower = Elite("slower", {"x": Comparison(improvement=0.9, selection_score=0.05)}, False)
    assert SELECTOR.best([slower, elite("honest", x=0.1)]) == "honest"


def test_a_candidate_that_fell_is_not_the_best_unless_allowed():
    candidates = [elite("fell", x=0.5, y=5, fell=True), elite("walks", x=0.1, y=1)]
    assert SELECTOR.best(candidates) == "walks"
    assert make({"allow_falls": True}).best(candidates) == "fell"


def test_an_earlier_best_keeps_its_place_whoever_stands_beside_it():
    a, b, c = elite("a", x=0.2, y=2), elite("b", x=0.1, y=3), elite("c", x=9, y=0.001)
    assert SELECTOR.best([a, b]) == SELECTOR.best([a, b, c]) == "a"


def test_weights_say_what_counts_more():
    candidates = [elite("a", x=4, y=1), elite("b", x=2, y=3)]
    assert SELECTOR.best(candidates) == "b"  # 4 against 6
    assert make({"weights": {"x": 2}}).best(candidates) == "a"  # 16 * 1 against 4 * 3
    assert make({"weights": {"y": 0}}).best([elite("a", x=4, y=-1), elite("b", x=2, y=3)]) == "a"


def test_naming_an_objective_that_does_not_run_is_refused():
    with pytest.raises(ConfigError, match="No objective named 'yy'. Did you mean 'y'"):
        make({"weights": {"yy": 1}}).best([elite("a", x=0.3, y=0.1)])


def test_weights_that_leave_nothing_to_choose_by_are_refused():
    with pytest.raises(ConfigError, match="every weight is 0"):
        make({"weights": {"x": 0}}).best([elite("a", x=0.3)])


@pytest.mark.parametrize("weights", [{"x": -1.0}, {"x": math.nan}])
def test_weights_that_make_no_sense_are_refused(weights):
    with pytest.raises(ValidationError):
        make({"weights": weights})
