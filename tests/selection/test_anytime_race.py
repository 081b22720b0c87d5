"""`racing` with test=anytime: the error holds however many rounds there are, and a clear winner ends the race."""

from __future__ import annotations

import math

import numpy as np
import pytest

from hts.selection import anytime, racing
from hts.selection.racing import RacingSettings
from hts.testing.known_race import KnownRounds, run_race

NAN = math.nan


def dropped(candidates: int, rounds: int, still_racing, trials: int = 300) -> float:
    """How often candidate 0, as good as the others, leaves a race whose halves scatter and share something."""
    rng, count = np.random.default_rng(0), 0
    for _ in range(trials):
        table = rng.standard_normal((candidates, 2 * rounds)) + 3.0 * rng.standard_normal(2 * rounds) + 50.0
        left = list(range(candidates))
        for number in range(1, rounds + 1):
            left = still_racing(table[:, : 2 * number], left)
            if 0 not in left or len(left) < 2:
                break
            table[[row for row in range(candidates) if row not in left], 2 * number :] = NAN
        count += 0 not in left
    return count / trials


@pytest.mark.parametrize("candidates", [2, 3, 6])
def test_among_equals_one_is_dropped_no_more_often_than_stated_in_many_rounds(candidates):
    def test(table, left):
        return anytime.still_racing(table, left, 0.05 / candidates, 0.0)

    assert dropped(candidates, 25, test) <= 0.05


def test_looking_in_many_rounds_by_plain_t_tests_would_drop_it_too_often():
    def uncorrected(table, left):
        return racing.still_racing(table, left, 0.05 / 3, 0.0)

    assert dropped(3, 25, uncorrected) > 0.1


def test_a_candidate_is_out_when_its_differences_lie_beyond_zero():
    table = np.array([[5.0, 5.1, 4.9, 5.0, 5.1, 4.9], [4.0, 4.1, 4.0, 3.9, 4.1, 4.0], [4.9, 5.2, 5.0, 4.9, 5.0, 5.0]])
    shared = np.array([10.0, -2.0, 3.0, 0.0, 5.0, -1.0])
    assert anytime.still_racing(table, [0, 1, 2], 0.02, 0.0) == [0, 2]
    assert anytime.still_racing(table + shared, [0, 1, 2], 0.02, 0.0) == [0, 2]
    assert anytime.still_racing(table[:, :2], [0, 1, 2], 0.02, 0.0) == [0, 1, 2]  # two units say nothing


@pytest.mark.parametrize("missing", [0, 1, (0, 1, 2)])
def test_who_was_not_measured_yet_is_neither_out_nor_does_it_end_the_race(missing):
    table = np.array([[5.0], [4.0], [4.5]])
    table[missing, :] = NAN
    assert anytime.still_racing(table, [0, 1, 2], 0.02, 0.1) == [0, 1, 2]


def test_who_was_not_measured_yet_does_not_lead_a_race_by_t_tests_either():
    table = np.array([[5.0, 5.1, 4.9, 5.0], [4.0, 4.1, 4.0, 3.9], [NAN] * 4])
    assert racing.still_racing(table, [0, 1, 2], 0.02, 0.1) == [0, 2]
    assert racing.still_racing(table, [0, 1], 0.02, 0.1) == [0]


def test_who_is_no_better_than_the_reference_is_out():
    worse = np.array([[-1.0, -1.1, -0.9, -1.0, -1.1, -0.9], [-0.9, -1.0, -1.1, -1.0, -0.9, -1.1]])
    assert anytime.still_racing(worse, [0, 1], 0.02, 0.0) == []


def test_indifference_ends_a_race_of_equals():
    table = np.array([[10.0, 10.1, 9.9, 10.0, 10.1, 9.9], [10.0, 10.0, 10.0, 10.1, 9.9, 10.0]])
    assert anytime.still_racing(table, [0, 1], 0.02, 0.0) == [0, 1]
    assert anytime.still_racing(table, [0, 1], 0.02, 0.1) == [0]


def test_a_race_is_decided_when_nobody_can_be_better_by_what_matters():
    # The leader is 0.5 ahead, give or take 0.2 a unit: k = (91 / 0.02^2)^(1/6) = 7.81, so the half width is
    # sqrt(6.81 / (1 - 7.81 / 91)) x 0.2 = 0.546, and the other could be better by 0.046. The leader has 10.
    table = np.array([[10.2, 9.8] * 3, [9.5] * 6])
    assert anytime.still_racing(table, [0, 1], 0.02, 0.0050) == [0]
    assert anytime.still_racing(table, [0, 1], 0.02, 0.0042) == [0, 1]


def test_a_race_with_a_clear_winner_is_short_however_many_rounds_it_may_have():
    world = KnownRounds(savings=(0.05, 0.12, 0.04))
    for seed in range(5):
        tests = run_race(world, RacingSettings(test="anytime", rounds=20), seed)
        scores = {name: found.tested.comparisons["cost"].selection_score for name, found in tests.results.items()}
        assert max(scores, key=scores.get) == "candidate-1"
        assert len(tests.races) <= 4
