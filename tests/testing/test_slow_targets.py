"""A target that remembers longer than a trial is named by the kit, with what to take instead."""

from __future__ import annotations

import numpy as np
import pytest

from hts.errors import PluginError
from hts.plugins import Entry, load
from hts.testing.checks.ensure import NotTried
from hts.testing.checks.instruments import remembered
from hts.testing.checks.objectives import score_lets_nan_through, scores_each_segment, target_forgets
from hts.testing.examples.instrument.instrument import CHANNEL, Settings, Warmth
from hts.testing.examples.objective.objective import Fake
from hts.testing.packages import kit_installed, on_path

SLOW = """
from hts import hookimpl

HTS_API = 2


def make(settings, robot):
    from hts.testing.examples.instrument.instrument import Warmth

    return Warmth()


@hookimpl
def hts_instruments(register):
    register("warmth", make)
"""


class Warm:
    """What the check asks of an objective."""

    instrument, target, real_channels = "warmth", CHANNEL, (CHANNEL,)


def test_a_target_that_remembers_minutes_is_refused_in_one_line(install):
    with on_path(install("warm-lab", {"warm_lab": SLOW}, {"warm": "warm_lab"})):
        registry = load()
        entry = Entry("warm", lambda settings: Warm(), "warm-lab")
        with pytest.raises(
            PluginError, match="'warmth_reading' remembers: 8.% .*cannot measure it.*also_measured"
        ) as error:
            target_forgets(entry, registry)
        assert "\n" not in str(error.value)


@pytest.mark.parametrize(("seconds", "left"), [(1.0, 0.0), (5.0, 0.15), (60.0, 0.89)])
def test_what_is_remembered_follows_the_time_constant(seconds, left):
    """Of means over the last second: exp(-9.5/T) (1 - exp(-10/T)) / (1 - exp(-9.5/T)), T in s."""
    quick = Warmth(Settings(resistance=1.0, capacity=seconds, noise=1e-6))
    assert remembered(quick, CHANNEL.name) == pytest.approx(left, abs=0.02)


def test_motion_that_changes_less_than_the_noise_says_nothing():
    assert remembered(Warmth(Settings(noise=50.0)), CHANNEL.name) == 0.0


def test_a_score_of_several_numbers_a_segment_is_said_once():
    class Several(Fake):
        def score(self, segments):
            return {name: np.stack([values, values], -1) for name, values in super().score(segments).items()}

    entry = Entry("fake", lambda settings: Several(), "lab")
    with kit_installed():
        with pytest.raises(PluginError, match=r"score '\w+' has shape \(\d+, 2\) for segments"):
            scores_each_segment(entry, load())
        with pytest.raises(NotTried):
            score_lets_nan_through(entry, load())
