"""Plans of a run's real samples, worked by hand: 50 Hz, first data of three recordings of 20 s, and tests of 40 s."""

from __future__ import annotations

from typing import Any

import pytest

from hts.config import ScheduleConfig
from hts.config_loading import load_config
from hts.errors import ConfigError
from hts.overrides import Override
from hts.plugins import load
from hts.run.budget import Budget, plan, shortened
from hts.schedules import Command
from hts.testing.packages import kit_installed

FIRST, EACH = 3 * 20 * 50, 41 * 50
"""A test takes 1 % or a second more than the world says, whichever is more."""
SETTINGS: dict[str, Any] = {
    "collection.schedule": {"commands": [{"seconds": 12.0, "vx": 0.5}, {"seconds": 8.0, "vx": 0.8}]},
    "collection.repeats": 2,
    "collection.exploring": 1,
    "iterations": 2,
    "sweep.weights.fake": [1.0],
    "sweep.anchors": ["pretrained", "best"],
    "sweep.kl_bounds": [0.5, 1.0],
    "finetune.also_at": [],
    "selection.elites": 3,
    "selection.speeds": [0.8],
    "selection.block_seconds": None,
}
"""Two candidates, of which all are tested; then four (two anchors), of which three are."""
WHOLE = FIRST + 5 * EACH


class Stopwatch:
    """What a plan asks of a world."""

    def __init__(self, seconds: float) -> None:
        self.seconds = seconds

    def head_to_head_seconds(self) -> float:
        return self.seconds

    def head_to_head_session_seconds(self, speeds: int, block_seconds: float | None) -> float:
        return 100 * speeds + (block_seconds or 0)


@pytest.fixture(scope="module")
def installed():
    with kit_installed():
        yield load()


@pytest.fixture
def planned(installed):
    def found(seconds: float = 40.0, **changes: Any) -> Budget:
        """changes: of SETTINGS, __ for a dot."""
        settings = {**SETTINGS, **{key.replace("__", "."): value for key, value in changes.items()}}
        overrides = [Override.of(key, value) for key, value in settings.items()]
        config = load_config(
            preset="smoke", objectives=["fake"], robot="tiny", world="known", overrides=overrides, registry=installed
        )
        return plan(config, installed, Stopwatch(seconds))

    return found


def lengths(budget: Budget) -> list[float]:
    return [command.seconds for command in budget.schedule.commands]


def test_without_a_cap_each_iteration_tests_what_it_wants(planned):
    whole = planned()
    assert (whole.first, whole.each, whole.elites, whole.wanted) == (3000, 2050, (2, 3), (2, 3))
    assert whole.samples == WHOLE == 13250 and whole.most is None and lengths(whole) == [12.0, 8.0]
    assert planned(finetune__also_at=[0.5]).wanted == (3, 3)  # each of two candidates at two moments


@pytest.mark.parametrize(
    ("seconds", "each"),
    [(40.0, 2050), (99.0, 5000), (100.0, 5050), (200.0, 10100), (40.005, 2051), (0.0, 50)],
)
def test_a_test_is_counted_with_an_allowance_in_whole_samples(planned, seconds, each):
    assert planned(seconds).each == each


def test_several_speeds_or_a_block_of_ones_own_make_a_session(planned):
    assert planned(selection__speeds=[0.5, 0.8]).each == 50 * 202
    assert planned(selection__block_seconds=100.0).each == 50 * 202


def test_first_data_are_counted_in_whole_samples_a_recording(planned):
    """12.01 and 8 s are 1000.5 samples, so 1001; and none where nothing is learned from them."""
    longer = {"commands": [{"seconds": 12.01, "vx": 0.5}, {"seconds": 8.0, "vx": 0.8}]}
    assert planned(collection__schedule=longer).first == 3003
    assert planned(collection__exploring=0).first == 2000
    assert planned(reward_source="proxy", sweep__trust_region__enabled=False).first == 0
    with pytest.raises(ConfigError, match=r"half of the first data are 1502 .* Expected 3552 at least"):
        planned(collection__schedule=longer, max_real_samples=3500)


def test_second_trials_are_of_several_speeds_and_of_no_more_than_were_tested(planned):
    both = {"selection__speeds": [0.5, 0.8]}
    assert planned(**both, selection__confirm=2).confirm == 2
    assert planned(**both, selection__confirm=2).samples == FIRST + 7 * 10100
    assert planned(selection__confirm=2).confirm == 0  # at a single speed
    assert planned(**both, selection__confirm=9).confirm == 5
    assert planned(**both, iterations=1, selection__confirm=2).confirm == 2
    assert planned(**both, iterations=1, selection__confirm=2, selection__elites=1).confirm == 0


def test_a_cap_that_all_fits_in_leaves_all_and_a_sample_less_shortens_first_data(planned):
    """Of 2999 samples a recording gets 999 2/3, which makes 11.996 and 7.997 s: 11.98 and 7.98 in whole steps."""
    assert planned(max_real_samples=WHOLE).elites == (2, 3) and lengths(planned(max_real_samples=WHOLE)) == [12.0, 8.0]
    less = planned(max_real_samples=WHOLE - 1)
    assert less.elites == (2, 3) and lengths(less) == pytest.approx([11.98, 7.98])
    assert less.first == 3 * 998 and less.samples == 2994 + 5 * 2050 <= less.most == WHOLE - 1


def test_first_data_are_never_more_than_was_asked_for(planned):
    found = planned(max_real_samples=FIRST + 2 * EACH + 100)
    assert (found.elites, found.first, lengths(found)) == ((1, 1), FIRST, [12.0, 8.0])


def test_half_of_the_first_data_and_one_test_are_the_least(planned):
    """1500 samples, 500 a recording: 10 s, so 6 and 4."""
    found = planned(max_real_samples=FIRST // 2 + EACH)
    assert (found.elites, found.first, found.samples) == ((1,), 1500, 3550) and lengths(found) == [6.0, 4.0]
    with pytest.raises(ConfigError, match=r"max_real_samples=3549: half of the first data are 1500 .* takes 2050"):
        planned(max_real_samples=FIRST // 2 + EACH - 1)


def test_a_cap_leaves_nothing_for_second_trials_where_not_all_fits(planned):
    """Without them 53,500 are asked for, which fit; with two there would be 73,700."""
    found = planned(selection__speeds=[0.5, 0.8], selection__confirm=2, max_real_samples=60_000)
    assert (found.confirm, found.elites, found.first) == (0, (2, 3), FIRST)
    assert planned(selection__speeds=[0.5, 0.8], selection__confirm=2, max_real_samples=73_700).confirm == 2
    found = planned(selection__speeds=[0.5, 0.8], selection__confirm=2, max_real_samples=73_699)
    assert (found.confirm, found.elites, found.first) == (0, (2, 3), FIRST)  # and no more tests than are wanted


def test_what_is_overspent_leaves_no_test_rather_than_less_than_none():
    schedule = ScheduleConfig(commands=(Command(seconds=12.0, vx=0.5),))
    assert Budget(schedule, (2, 2), first=1000, each=400, most=2600, wanted=(2, 2)).affordable([2], spent=3500) == 0


def test_a_command_is_shortened_to_four_seconds_and_a_short_one_not_at_all():
    """1 s is the shortest that a schedule takes; in whole control steps each."""
    eight, three = Command(seconds=8.0, vx=0.8), Command(seconds=3.0, vx=0.5)
    assert shortened(ScheduleConfig(commands=(eight,)), 4.0, 50.0).commands[0].seconds == 4.0
    with pytest.raises(ConfigError, match=r"leaves 4\.0 s for each 8 s of collection.schedule, and 4 s are needed"):
        shortened(ScheduleConfig(commands=(eight,)), 3.99, 50.0)
    assert shortened(ScheduleConfig(commands=(three,)), 3.0, 50.0).commands[0].seconds == 3.0
    with pytest.raises(ConfigError, match=r"leaves 3\.0 s for each 3 s"):
        shortened(ScheduleConfig(commands=(three,)), 2.99, 50.0)
