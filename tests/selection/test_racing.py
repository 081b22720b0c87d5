"""The selector `racing`, rounds in worlds, and the stage that holds the race."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
import yaml

from hts import api
from hts.config import EvaluationConfig
from hts.contracts import Comparison, RacedCandidate, Rounds
from hts.contracts import TestedCandidate as Elite  # under its own name pytest takes it for a test class
from hts.errors import ConfigError, PluginError
from hts.evaluation.final import CandidateResult
from hts.evaluation.halves import halves
from hts.evaluation.head_to_head import point
from hts.recordings.recording import Series
from hts.run.testing_elites import Tests
from hts.selection import racing
from hts.selection.racing import RacingSettings, make, of_rounds, residual_variance, still_racing
from hts.testing.known_race import KnownRounds, run_race
from hts.testing.made_up_recordings import CostObjective
from hts.worlds.base import round_order
from hts.worlds.twin.programme import head_to_head

NAN = math.nan
LEVEL = 0.025  # one-sided; t with 3 degrees of freedom is 3.182


def raced(name, *scores, fell=False, racing=True, measured=True):
    """A candidate whose halves scored so."""
    found = [None if math.isnan(score) else {"x": Comparison(score, score)} for score in scores]
    mean = float(np.nanmean(scores)) if measured else 0.0
    return RacedCandidate(name, Elite(name, {"x": Comparison(mean, mean)}, fell) if measured else None, racing, found)


# --------------------------------------------------------------------------------------------- the test itself


@pytest.mark.parametrize(
    ("test", "unit", "level"),
    [
        ("anytime", "round", 0.06 / 3),
        ("looks", "round", 0.06 / (2 * 3)),  # after the second and the third of four rounds
        ("looks", "half", 0.06 / (3 * 3)),
    ],
)
def test_the_error_is_shared_among_all_that_were_raced_whoever_fell_since(monkeypatch, test, unit, level):
    asked = []
    for module in (racing, racing.anytime):
        judge = lambda table, left, error, indifference: asked.append(error) or list(left)
        monkeypatch.setattr(module, "still_racing", judge)
    selector = make({"objective": "x", "error": 0.06, "rounds": 4, "test": test, "unit": unit})
    field = [raced("a", 1.0, 1.1), raced("b", 0.9, 1.0), raced("c", 0.5, 0.4, fell=True)]
    assert selector.keep(field) == ["a", "b"] and asked == [pytest.approx(level)]


def test_what_candidates_and_halves_explain_is_no_scatter():
    assert residual_variance(np.array([[1.0, 2.0, 5.0], [3.0, 4.0, 7.0]])) == (pytest.approx(0.0), 2)


def test_the_scatter_is_what_is_left_over_its_degrees_of_freedom():
    # rows' means 0 and 2, columns' means 0 and 2, in all 1: each number lies 1 off
    assert residual_variance(np.array([[0.0, 0.0], [0.0, 4.0]])) == (pytest.approx(4.0), 1)


def test_a_gap_costs_a_degree_of_freedom():
    table = np.array([[1.0, 2.0, 5.0, 6.0], [3.0, 4.0, NAN, NAN], [0.0, 1.0, 4.0, 5.0]])
    assert residual_variance(table) == (pytest.approx(0.0), 10 - 3 - 4 + 1)
    assert residual_variance(np.full((2, 2), NAN)) == (0.0, 0)


def test_a_candidate_is_dropped_when_it_lies_further_behind_than_t_times_its_standard_error():
    # differences 2, 4, 3, 3: mean 3, variance 2/3, standard error sqrt(2/3 / 4) = 0.408, times 3.182 = 1.299
    table = np.array([[3.0, 5.0, 4.0, 4.0], [1.0, 1.0, 1.0, 1.0], [3.5, 4.5, 4.0, 3.9]])
    assert still_racing(table[:2], [0, 1], LEVEL, 0.0) == [0]
    assert still_racing(table[:2] - [[0.0], [-1.6]], [0, 1], LEVEL, 0.0) == [0]  # behind by 1.4
    assert still_racing(table[:2] - [[0.0], [-1.8]], [0, 1], LEVEL, 0.0) == [0, 1]  # behind by 1.2
    assert still_racing(table, [0, 1, 2], LEVEL, 0.0) == [0, 2]


def test_what_all_share_in_a_half_does_not_count():
    table = np.array([[3.0, 5.0, 4.0, 4.0], [2.0, 4.1, 2.9, 3.0]])
    shared = np.array([10.0, -20.0, 0.0, 5.0])
    assert still_racing(table, [0, 1], LEVEL, 0.0) == [0]
    assert still_racing(table + shared, [0, 1], LEVEL, 0.0) == [0]


def test_the_race_is_decided_when_nobody_can_be_better_by_more_than_the_indifference():
    # differences 0, 1, 0, 1: 0.5 ± 0.919, so the other may be better by 0.419; the leader's mean is 10.5
    table = np.array([[10.0, 11.0, 10.0, 11.0], [10.0, 10.0, 10.0, 10.0]])
    assert still_racing(table, [0, 1], LEVEL, 0.039) == [0, 1]
    assert still_racing(table, [0, 1], LEVEL, 0.041) == [0]


def test_a_leader_that_does_not_improve_has_no_indifference():
    table = np.array([[-10.0, -11.0, -10.0, -11.0], [-10.5, -10.9, -10.5, -10.9]])
    assert still_racing(table, [0, 1], LEVEL, 0.5) == [0, 1]


def test_one_half_is_too_little_to_drop_anybody():
    assert still_racing(np.array([[0.5], [0.1]]), [0, 1], LEVEL, 0.0) == [0, 1]
    assert still_racing(np.array([[0.5, NAN], [NAN, 0.1]]), [0, 1], LEVEL, 0.0) == [0, 1]


def error_rate(unit: str, level: float | None = None, own: float = 0.0, trials: int = 400) -> float:
    """How often candidate 0, as good as two others, is dropped in a race of four rounds whose halves scatter and share
    something. level: None: the selector's; own: standard deviation of what a session has of its own for each."""
    rng, dropped, candidates, rounds = np.random.default_rng(0), 0, 3, 4
    level = make({"unit": unit, "rounds": rounds}).level(candidates) if level is None else level
    for _ in range(trials):
        halves = rng.standard_normal((candidates, 2 * rounds)) + 3.0 * rng.standard_normal(2 * rounds)
        halves += np.repeat(own * rng.standard_normal((candidates, rounds)), 2, axis=1)
        racing = list(range(candidates))
        for number in range(1, rounds):  # nothing is decided after the last
            table = halves[:, : 2 * number].copy()
            racing = still_racing(of_rounds(table) if unit == "round" else table, racing, level, 0.0)
            if 0 not in racing:
                dropped += 1
                break
            halves[[row for row in range(candidates) if row not in racing], 2 * number :] = NAN
    return dropped / trials


@pytest.mark.parametrize("unit", ["half", "round"])
def test_among_equals_one_is_dropped_in_no_more_races_than_the_error_says(unit):
    assert error_rate(unit) <= 0.05


@pytest.mark.parametrize("unit", ["half", "round"])
def test_looking_after_each_round_without_a_correction_would_drop_it_too_often(unit):
    assert error_rate(unit, level=0.05) > 0.10


def test_what_a_session_has_of_its_own_is_in_the_error_of_rounds_and_not_of_halves():
    assert error_rate("round", own=2.0) <= 0.05 < error_rate("half", own=2.0)


def test_halves_that_are_not_two_of_each_round_are_a_mistake_of_the_world():
    field = [raced("a", 1.0, 1.1, 1.0), raced("b", 0.9, 1.0, 0.9)]
    with pytest.raises(PluginError, match=r"'racing': a has 3 halves, expected two of each round\. The world must"):
        make({}).keep(field)


def test_a_round_is_the_mean_of_its_halves_and_none_without_one_of_them():
    found = of_rounds(np.array([[1.0, 2.0, 3.0, 5.0], [4.0, NAN, NAN, NAN]]))
    assert found[0].tolist() == [1.5, 4.0] and np.isnan(found[1]).all()


# ------------------------------------------------------------------------------------------------ the selector


def test_who_fell_or_could_not_be_measured_is_out():
    halves = (1.0, 1.1, 0.9, 1.0)
    candidates = [raced("fell", *halves, fell=True), raced("a", *halves), raced("b", *halves[::-1])]
    assert make({}).keep([*candidates, raced("refused", NAN, NAN, measured=False)]) == ["a", "b"]
    assert make({"allow_falls": True, "indifference": 0.0}).keep(candidates) == ["fell", "a", "b"]


def test_who_is_clearly_no_better_than_the_reference_is_out_and_so_may_be_all():
    worse = [raced("a", -1.0, -1.02, -0.98, -1.0), raced("b", -1.01, -1.0, -0.99, -1.0)]
    assert make({}).keep(worse) == []
    assert make({}).keep([*worse, raced("c", 1.0, 1.1, 0.9, 1.0)]) == ["c"]


def test_one_that_is_left_needs_no_further_round():
    assert make({}).keep([raced("a", 1.0, 1.0), raced("b", 0.9, 0.9, racing=False)]) == ["a"]


def test_rounds_are_the_units_unless_halves_are_asked_for():
    # halves differ by 1, 1, 0.5 and 0.5; rounds by 1 and 0.5, which two of them do not tell from nothing
    candidates = [raced("a", 2.0, 2.0, 2.0, 2.0), raced("b", 1.0, 1.0, 1.5, 1.5)]
    strict = {"indifference": 0.0, "error": 0.2}
    assert make(strict).keep(candidates) == ["a", "b"]
    assert make({**strict, "unit": "half"}).keep(candidates) == ["a"]


def test_those_that_are_out_stay_out():
    candidates = [raced("a", 1.0, 1.5), raced("b", 1.1, 1.2, racing=False), raced("c", 1.2, 1.1)]
    assert make({"indifference": 0.0}).keep(candidates) == ["a", "c"]


def test_the_objective_that_is_named_decides_and_a_wrong_name_is_one_line():
    def both(name, x, y):
        found = [{"x": Comparison(a, a), "y": Comparison(b, b)} for a, b in zip(x, y, strict=True)]
        return RacedCandidate(name, Elite(name, found[0], False), True, found)

    candidates = [both("a", (2.0, 2.1), (1.0, 1.1)), both("b", (1.0, 1.1), (2.0, 2.1))]
    halves = {"unit": "half"}
    assert make(halves).keep(candidates) == ["a"]  # no scatter is left, so it is clear
    assert make({**halves, "objective": "y"}).keep(candidates) == ["b"]
    with pytest.raises(ConfigError, match="Selector 'racing': No objective named 'z'"):
        make({"objective": "z"}).keep(candidates)


def test_other_selectors_ask_for_no_rounds():
    from hts.selection.hierarchical import make as hierarchical

    assert hierarchical({}).rounds() is None
    assert make({"block_seconds": 20, "rounds": 3}).rounds() == Rounds(20.0, 3)


# ------------------------------------------------------------------------------------------- races, as recorded


def test_a_race_finds_a_clear_winner_with_less_than_half_of_the_seconds():
    world = KnownRounds(savings=(0.08, 0.11, 0.10))
    for seed in range(10):
        tests = run_race(world, RacingSettings(), seed)
        scores = {name: found.tested.comparisons["cost"].selection_score for name, found in tests.results.items()}
        assert max(scores, key=scores.get) == "candidate-1"
        assert sum(recording.seconds for recording in tests.recorded) <= 0.4 * 3 * 320


class Days(KnownRounds):
    """What walking costs differs by 3 % from round to round, for everybody but the reference."""

    def round(self, racing, number, block_seconds, rng):
        rows = super().round(racing, number, block_seconds, rng)
        factor = 1 + 0.03 * rng.standard_normal()
        return [[one if one.role == "reference" else dearer(one, factor) for one in row] for row in rows]


def dearer(recording, factor):
    cost = recording.channels["cost"]
    return recording.replace(channels={**recording.channels, "cost": Series(cost.channel, cost.values * factor)})


def test_who_left_in_a_flattering_round_is_not_the_best_by_it():
    selector, flattered = make({}), 0
    for seed in range(60):
        world = Days((0.20, 0.199, 0.18), scatter=0.003, correlation=0.3)
        tests = run_race(world, RacingSettings(unit="half"), seed)
        everybody = [found.tested for found in tests.results.values()]
        flattered += selector.best(everybody) not in tests.races[-1]["racing"]
        assert selector.best(tests.for_best(selector)) in tests.races[-1]["racing"]
    assert flattered > 0, "these races show nothing"


def test_where_nobody_of_the_last_round_is_good_enough_the_best_that_left_is():
    results = {
        name: CandidateResult({}, Elite(name, {"x": Comparison(score, score)}, fell), None)
        for name, score, fell in (("a", 0.3, True), ("b", 0.1, False))
    }
    tests = Tests({}, [], results, [{"racing": ["a", "b"]}, {"racing": ["a"]}])
    selector = make({"objective": "x"})
    assert selector.best(tests.for_best(selector)) == "b"


def test_the_budget_ends_a_race_that_nothing_decides():
    tests = run_race(KnownRounds(savings=(0.1, 0.1)), RacingSettings(indifference=0.0, rounds=3, error=1e-6), 0)
    assert len(tests.races) == 3
    assert tests.races[-1]["going_on"] == []
    assert sum(recording.seconds for recording in tests.recorded) == 3 * 6 * 15


def test_blocks_that_candidates_share_are_counted_once():
    tests = run_race(KnownRounds(savings=(0.1, 0.1, 0.1)), RacingSettings(rounds=1), 0)
    assert len(tests.recorded) == 8
    assert [len(found) for found in tests.of.values()] == [4, 4, 4]


def test_the_two_halves_of_a_round_average_to_the_whole():
    world = KnownRounds(savings=(0.1, 0.2), scatter=0.0, drift=0.04)
    objective = {"cost": CostObjective()}
    for row, saving in zip(world.round([0, 1], 0, 15, np.random.default_rng(0)), world.savings, strict=True):
        scores = [half["cost"].improvement for half in halves(objective, row, EvaluationConfig())]
        assert scores[0] < saving < scores[1]  # first the reference walks earlier, then the policy
        assert np.mean(scores) == pytest.approx(saving, abs=1e-3)
        assert point(objective["cost"], row, EvaluationConfig()).improvement == pytest.approx(saving, abs=1e-3)


def test_a_half_in_which_it_did_not_walk_is_none():
    from hts.testing.made_up_recordings import known_recording

    costs = {"reference": 100.0, "policy": 90.0}
    row = [
        known_recording([costs[role]] * 15, role=role, block=block, speed=0.8 if block < 2 else 0.5)
        for block, role in enumerate(("reference", "policy", "policy", "reference"))
    ]
    first, second = halves({"cost": CostObjective()}, row, EvaluationConfig())
    assert first["cost"].improvement == pytest.approx(0.1)
    assert second is None


# ---------------------------------------------------------------------------------------------- rounds in worlds


@pytest.mark.parametrize("policies", [1, 2, 3, 6])
@pytest.mark.parametrize("number", [0, 1, 5])
def test_in_a_round_everybody_has_the_same_mean_time_and_a_block_in_each_half(policies, number):
    order = round_order(policies, number)
    everybody = {None, *range(policies)}
    assert len(order) == 2 * len(everybody)
    for who in everybody:
        first, second = (place for place, walks in enumerate(order) if walks == who)
        assert first + second == len(order) - 1
        assert first < len(everybody) <= second


def test_another_one_begins_each_round():
    assert round_order(2, 0) == [None, 0, 1, 1, 0, None]
    assert round_order(2, 1) == [0, 1, None, None, 1, 0]


def test_a_round_on_the_twin_is_one_session_after_one_warm_up():
    session = head_to_head(["a", "b"], "r", [0.8], warmup=20.0, block=15.0, number=1, session="s")
    recorded = [(block.policy, block.role, block.index) for block in session.blocks if block.recorded]
    assert [policy for policy, _, _ in recorded] == ["a", "b", "r", "r", "b", "a"]
    assert [role for _, role, _ in recorded] == ["policy", "policy", "reference", "reference", "policy", "policy"]
    assert [index for _, _, index in recorded] == list(range(6))
    assert session.seconds == 1.0 + 20.0 + 6 * 15.0
    assert [block.policy for block in session.blocks if block.settle] == ["r", "r"]


# ----------------------------------------------------------------------------------------------------- the stage


def start_race(folder: Path, **settings) -> None:
    """As if the finished run in `folder` had been told to race its two candidates, and stopped before that."""
    path = folder / "config.yaml"
    config = yaml.safe_load(path.read_text())
    config["selection"]["elites"] = 2
    config["selection"]["selector"] = {
        "name": "racing",
        "block_seconds": 3.0,
        "rounds": 2,
        "indifference": 0.0,
        **settings,
    }
    path.write_text(yaml.safe_dump(config))
    provenance = folder / "provenance.json"
    begun = json.loads(provenance.read_text())
    del begun["config_sha256"]  # else the edit is refused
    provenance.write_text(json.dumps(begun))
    for stage in ("iterations/00/simulate", "iterations/00/gate", "iterations/00/test", "final", "summary"):
        (folder / f"{stage}.json").unlink()


@pytest.mark.slow
def test_a_run_that_races_ends_the_same_when_it_is_stopped_in_the_midst_of_it(broken_run, monkeypatch):
    from hts.recordings.store import RecordingStore
    from hts.worlds.twin.world import TwinWorld

    start_race(broken_run, error=1e-6)
    (broken_run / "report.html").unlink()  # else it stays as it is, of the run that did not race
    really, asked = TwinWorld.head_to_head_round, []

    def stop_at_the_second(self, *arguments):
        asked.append(arguments[3])
        if len(asked) == 2:
            raise KeyboardInterrupt
        return really(self, *arguments)

    before = set(RecordingStore(broken_run / "data.zarr").ids())
    monkeypatch.setattr(TwinWorld, "head_to_head_round", stop_at_the_second)
    with pytest.raises(KeyboardInterrupt):
        api.resume(broken_run)
    assert not (broken_run / "iterations/00/test.json").exists()
    api.resume(broken_run)
    assert asked == [0, 1, 0, 1]

    content = (broken_run / "iterations/00/test.json").read_bytes()
    test = json.loads(content)
    assert [row["racing"] for row in test["rounds"]] == [test["elites"]] * 2
    assert len(test["recordings"]) == len(set(test["recordings"])) == 2 * 6
    assert test["samples"] == 2 * 6 * 3 * 50
    assert set(test["results"]) == set(test["elites"])
    store = RecordingStore(broken_run / "data.zarr")
    assert store.validate() == []
    made = set(store.ids()) - before
    assert set(test["recordings"]) <= made

    summary = (broken_run / "summary.json").read_bytes()
    for stage in ("iterations/00/test", "final", "summary"):
        (broken_run / f"{stage}.json").unlink()
    api.resume(broken_run)
    assert (broken_run / "iterations/00/test.json").read_bytes() == content
    again, first = json.loads((broken_run / "summary.json").read_bytes()), json.loads(summary)
    assert {**again, "wall_seconds": 0} == {**first, "wall_seconds": 0}
    assert set(RecordingStore(broken_run / "data.zarr").ids()) - before == made


@pytest.mark.slow
def test_in_a_world_that_knows_no_rounds_elites_get_whole_head_to_heads(broken_run, monkeypatch, capsys):
    from hts.contracts import World
    from hts.worlds.twin.world import TwinWorld

    start_race(broken_run)
    monkeypatch.setattr(TwinWorld, "head_to_head_round", World.head_to_head_round)
    api.resume(broken_run)
    test = json.loads((broken_run / "iterations/00/test.json").read_text())
    assert "rounds" not in test
    assert test["samples"] == 2 * 4 * 3 * 50
    assert "World 'twin' knows no rounds" in capsys.readouterr().out
