"""The `hierarchical` selector."""

from __future__ import annotations

from dataclasses import replace

import pytest

from hts.contracts import Comparison, FineTuning, SimulatedCandidate
from hts.contracts import TestedCandidate as Elite  # under its own name pytest takes it for a test class
from hts.errors import ConfigError
from hts.run.judging import mean_gain, speeds_predicted
from hts.selection.hierarchical import make

SELECTOR = make({})


def simulated(name, score, falls=0, tracked=True):
    return SimulatedCandidate(name, score, falls, tracked)


def elite(name, *, fell=False, **scores):
    return Elite(name, {objective: Comparison(score, score) for objective, score in scores.items()}, fell)


def test_elites_are_the_best_by_score():
    assert SELECTOR.elites([simulated("a", 1), simulated("b", 3), simulated("c", 2)], 2) == ["b", "c"]


def test_a_candidate_that_falls_or_misses_the_speed_ranks_behind_all_others():
    candidates = [simulated("falls", 9, falls=1), simulated("slow", 8, tracked=False), simulated("walks", -1)]
    assert SELECTOR.elites(candidates, 3) == ["walks", "slow", "falls"]


def test_a_score_that_is_not_a_number_ranks_last_of_all():
    candidates = [simulated("nan", float("nan")), simulated("falls", 1, falls=5)]
    assert SELECTOR.elites(candidates, 2) == ["falls", "nan"]


def test_fewer_candidates_than_wanted_are_all_elites_and_ties_keep_their_order():
    assert SELECTOR.elites([simulated("a", 1), simulated("b", 1)], 6) == ["a", "b"]


def test_the_best_has_the_highest_selection_score():
    assert SELECTOR.best([elite("a", x=0.1), elite("b", x=0.3), elite("c", x=0.2)]) == "b"


def test_the_best_goes_by_selection_score_and_not_by_improvement():
    slower = Elite("slower", {"x": Comparison(improvement=0.3, selection_score=0.05)}, False)
    assert SELECTOR.best([slower, elite("honest", x=0.1)]) == "honest"


def test_nothing_is_best_if_nothing_improves():
    assert SELECTOR.best([elite("a", x=-0.1), elite("b", x=0.0)]) is None
    assert SELECTOR.best([elite("a", x=float("nan"))]) is None
    assert SELECTOR.best([]) is None


def test_a_candidate_that_fell_is_not_the_best_unless_allowed():
    candidates = [elite("fell", x=0.5, fell=True), elite("walks", x=0.1)]
    assert SELECTOR.best(candidates) == "walks"
    assert make({"allow_falls": True}).best(candidates) == "fell"


def test_with_several_objectives_the_first_one_decides_or_the_one_named():
    candidates = [elite("a", x=0.3, y=0.1), elite("b", x=0.1, y=0.3)]
    assert SELECTOR.best(candidates) == "a"
    assert make({"objective": "y"}).best(candidates) == "b"


def test_with_several_objectives_the_same_one_decides_in_simulation():
    candidates = [
        SimulatedCandidate("a", 4, 0, True, {"x": 3, "y": 1}),
        SimulatedCandidate("b", 9, 0, True, {"x": 1, "y": 8}),
    ]
    assert SELECTOR.elites(candidates, 1) == ["a"]
    assert make({"objective": "y"}).elites(candidates, 1) == ["b"]
    with pytest.raises(ConfigError, match="No objective named 'z'"):
        make({"objective": "z"}).elites(candidates, 1)


def test_naming_an_objective_that_does_not_run_is_refused():
    with pytest.raises(ConfigError, match="No objective named 'yy'. Did you mean 'y'"):
        make({"objective": "yy"}).best([elite("a", x=0.3, y=0.1)])


def bounded(name, score, bound, promised=None, **flags):
    made = FineTuning("best", {"x": 1.0}, bound, 0.9 * bound)
    predicted = {} if promised is None else {"x": promised}
    return SimulatedCandidate(
        name, score, flags.get("falls", 0), flags.get("tracked", True), {"x": score}, made, predicted
    )


def test_what_a_model_promises_ranks_before_the_reward():
    promised = [bounded("a", 2.0, 1.0, 0.1), bounded("b", 1.0, 1.0, 0.2)]
    assert make({}).elites(promised, 1) == ["b"]
    assert make({}).elites([bounded("a", 2.0, 1.0), bounded("b", 1.0, 1.0)], 2) == ["a", "b"]  # nobody has a promise


def test_one_without_a_promise_comes_behind_those_that_have_one_and_leaves_their_order_alone():
    """It has no second at the asked speed: a policy that stands still has the best r_real of all."""
    promised = [bounded("a", 2.0, 1.0, 0.1), bounded("b", 1.0, 1.0, 0.2)]
    without = [bounded("c", 3.0, 1.0), bounded("d", 4.0, 2.0)]
    assert make({}).elites([*without, *promised], 4) == ["b", "a", "d", "c"]
    fell = bounded("e", 9.0, 1.0, 0.9, falls=1)
    assert make({}).elites([fell, *without, *promised], 5) == ["b", "a", "d", "c", "e"]
    # nor is it what a trust region judges a bound by: d is alone under c = 2
    assert make({"each_bound": True}).elites([*without, *promised], 2) == ["b", "a"]


def test_a_promise_over_fewer_speeds_comes_behind_one_over_more():
    """By hand: at 0.5, 0.8 and 1.1 m/s "all" saves 0.3, 0.2 and 0.1, "part" 0.3 at 0.5 m/s and walks at no other."""
    over = {"all": {"0.5": 0.3, "0.8": 0.2, "1.1": 0.1}, "part": {"0.5": 0.3}}
    candidates = []
    for name, saved in over.items():
        promised = {"x": {speed: {"selection_score": one} for speed, one in saved.items()}}
        means, speeds = mean_gain(promised), speeds_predicted(promised)
        candidates.append(replace(bounded(name, 1.0, 1.0), tracked=False, predicted=means, predicted_speeds=speeds))
    whole, part = candidates
    assert (whole.predicted["x"], part.predicted["x"]) == (pytest.approx(0.2), 0.3)
    assert make({}).elites([part, whole], 2) == make({"each_bound": True}).elites([part, whole], 2) == ["all", "part"]
    assert make({}).elites([part, whole, bounded("none", 9.0, 1.0, tracked=False)], 3) == ["all", "part", "none"]


def test_the_best_of_each_bound_is_tried_before_any_second_one():
    group = [bounded("a", 5, 4.0), bounded("b", 4, 4.0), bounded("c", 1, 1.0), bounded("d", 2, 1.0)]
    assert make({}).elites(group, 2) == ["a", "b"]
    assert make({"each_bound": True}).elites(group, 3) == ["a", "d", "b"]


def test_the_best_of_a_bound_that_fell_is_no_reason_to_leave_a_sound_one_out():
    group = [bounded("a", 5, 3.0), bounded("b", 4, 3.0), bounded("fell", 3, 10.0, falls=1)]
    assert make({"each_bound": True}).elites(group, 2) == ["a", "b"]


def test_a_drawn_elite_does_not_hang_on_scores_and_is_sound():
    def drawn(scores):
        group = [bounded(f"{i:02d}", score, 1.0, falls=int(i == 3)) for i, score in enumerate(scores)]
        elites = make({"at_random": 1}).elites(group, 2)
        assert elites[0] == f"{scores.index(max(scores)):02d}" and len(set(elites)) == 2
        return elites[1]

    first = drawn([9.0, 1, 2, 8, 4, 5])
    assert first != "03"
    assert drawn([9.0, 5, 4, 8, 2, 1]) == first
