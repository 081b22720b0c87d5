"""What a candidate should save, by the arithmetic of a head-to-head."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from hts.contracts import Comparison, FollowVelocity
from hts.errors import PluginError
from hts.evaluation.predicted import pieces, predicted_comparison

RATE = 50


class Effort:
    """Scores a level above idle, and per metre."""

    name, target = "effort", SimpleNamespace(name="effort")

    def predicted_channels(self, target, known):
        return {"effort": target}

    def score(self, segments):
        net = segments.values("effort").mean(-1) - segments.idle("effort")
        return {"net": net, "per_metre": net / segments.speed / segments.mass_kg}

    def compare(self, policy, reference):
        saved = {name: 1 - policy[name] / reference[name] for name in policy}
        return Comparison(saved["net"], min(saved.values()), saved)


def known(idle=2.0, mass=10.0):
    return [SimpleNamespace(idle={"effort": idle}, mass_kg=mass)]


def walk(level, speed, objective=None, count=4, recordings=None):
    target = np.full((count, RATE), level)
    return pieces(objective or Effort(), target, np.full(count, speed), 0.8, recordings or known())


def test_net_and_per_metre_are_those_of_a_head_to_head():
    found = predicted_comparison(Effort(), walk(8.0, 0.76), walk(10.0, 0.8))
    assert found.improvement == pytest.approx(0.25)  # 6 for 8 above idle
    assert found.metrics["per_metre"] == pytest.approx(1 - (6 / 0.76) / (8 / 0.8))


def test_pieces_in_which_the_task_was_not_done_promise_nothing():
    assert predicted_comparison(Effort(), walk(8.0, 0.7), walk(10.0, 0.8)) is None  # 12 % slower than asked

    class Anyhow(FollowVelocity):
        def done(self, achieved, set_point, tolerance):
            return achieved > 0

    target = np.full((4, RATE), 8.0)
    slow = pieces(Effort(), target, np.full(4, 0.7), 0.8, known(), 0.1, Anyhow())
    assert predicted_comparison(Effort(), slow, walk(10.0, 0.8)).improvement == pytest.approx(0.25)


def test_nothing_is_promised_where_nothing_can_be_said():
    nobody = walk(8.0, 0.8, count=0)
    assert predicted_comparison(Effort(), nobody, walk(10.0, 0.8)) is None
    still = walk(2.0, 0.8)  # the reference draws nothing above idle: no share of it can be saved
    with np.errstate(divide="ignore", invalid="ignore"):
        assert predicted_comparison(Effort(), walk(2.0, 0.8), still) is None
    weightless = walk(8.0, 0.8, recordings=known(mass=None))
    assert predicted_comparison(Effort(), weightless, weightless) is None


def test_an_objective_that_scores_an_unpredicted_channel_promises_nothing():
    class Two(Effort):
        def score(self, segments):
            return {"net": segments.values("effort").mean(-1) * segments.values("other").mean(-1)}

    assert predicted_comparison(Two(), walk(8.0, 0.8), walk(10.0, 0.8)) is None


class Mistaken(Effort):
    """Its comparison asks a number for what it has not."""

    def compare(self, policy, reference):
        return Comparison(1 - policy["net"] / reference["net"].mean, 0.0)  # a float has no `mean`


class OfWrongType(Effort):
    """Its score asks an array for what it has not."""

    def score(self, segments):
        return {"net": segments.values("effort").average(-1)}


class OfNothing(Effort):
    """Its score forgets to return."""

    def score(self, segments):
        segments.values("effort").mean(-1)


@pytest.mark.parametrize(
    ("objective", "said"),
    [
        (
            Mistaken(),
            r"compare\(\) of what is predicted failed, AttributeError: 'float' object has no attribute 'mean'",
        ),
        (OfWrongType(), r"score\(\) of what is predicted failed, AttributeError: .* no attribute 'average'"),
        (OfNothing(), r"score gives a NoneType, expected names with arrays"),
    ],
)
def test_a_mistake_in_an_objective_is_named_and_does_not_mean_that_nothing_is_predicted(objective, said):
    with pytest.raises(PluginError, match=f"^Objective 'effort': {said}") as error:
        predicted_comparison(objective, walk(8.0, 0.8), walk(10.0, 0.8))
    assert "\n" not in str(error.value)


class OfBlocks(Effort):
    """Its score looks at recordings, of which a prediction has none."""

    def score(self, segments):
        return {"net": np.full(len(segments), len(segments.recordings))}


class OfAnother(Effort):
    """Its score reads a channel that nobody predicts."""

    def score(self, segments):
        return {"net": segments.values("other").mean(-1)}


class OfNoughts(Effort):
    """Its score divides by what is nought here."""

    def score(self, segments):
        return {"net": np.full(len(segments), 1 / int(segments.values("effort").min() - 8))}


@pytest.mark.parametrize(
    ("objective", "said"),
    [
        (OfBlocks(), "Its score reads `recordings` of segments, which is not predicted."),
        (OfAnother(), "Its score reads what nothing predicts. No channel named 'other'. Known: effort. Let predicted_"),
        (OfNoughts(), "Its score of predicted seconds fails, ZeroDivisionError: "),
    ],
)
def test_why_a_score_cannot_be_made_of_what_is_predicted_is_told(objective, said):
    told = []
    assert predicted_comparison(objective, walk(8.0, 0.8), walk(10.0, 0.8), told.append) is None
    assert len(told) == 1 and told[0].startswith(said)


def test_nothing_is_told_where_there_is_nobody_or_the_reference_is_nought():
    told = []
    nobody = walk(8.0, 0.8, count=0)
    assert predicted_comparison(Effort(), nobody, walk(10.0, 0.8), told.append) is None

    class Whole(Effort):
        def compare(self, policy, reference):
            return Comparison(1 // 0, 0.0)

    assert predicted_comparison(Whole(), walk(8.0, 0.8), walk(10.0, 0.8), told.append) is None
    assert told == []


def test_power_predicts_its_voltage_by_the_sag_in_the_recordings():
    power = pytest.importorskip("hts_power.objective", reason="the objective of this test is not installed").Power()
    rng = np.random.default_rng(0)
    current = np.repeat(rng.uniform(2, 12, 40), RATE)  # 1 s at each level
    values = {"battery_current": current, "battery_voltage": 25.0 - 0.15 * current}
    recording = SimpleNamespace(
        rate_hz=float(RATE),
        values=values.__getitem__,
        idle={"battery_current": 1.2, "battery_voltage": 24.8},
        mass_kg=12.0,
    )

    def seen(amperes):
        return pieces(power, np.full((3, RATE), amperes), np.full(3, 0.8), 0.8, [recording])

    assert seen(6.0).values("battery_voltage")[0, 0] == pytest.approx(25 - 0.9, abs=1e-6)
    found = predicted_comparison(power, seen(5.0), seen(6.0))
    idle = 1.2 * 24.8
    assert found.improvement == pytest.approx(1 - (5 * (25 - 0.75) - idle) / (6 * (25 - 0.9) - idle))


@pytest.mark.parametrize(
    ("makes", "said"),
    [
        (lambda target: 1 / 0, r"failed, ZeroDivisionError"),
        (lambda target: None, r"gave NoneType, expected a dict of channel -> samples of each piece"),
        (lambda target: {"effort": target.mean()}, r"gave 'effort' in shape \(\) for a target of \(4, 50\)"),
        (
            lambda target: {"effort": target.mean(1)},
            r"gave 'effort' in shape \(4,\) .* expected \(4, n, \.\.\.\), the samples",
        ),
        (lambda target: {"effort": target[:1]}, r"gave 'effort' in shape \(1, 50\)"),
    ],
)
def test_an_objective_whose_predicted_channels_are_no_samples_is_named(makes, said):
    class Odd(Effort):
        def predicted_channels(self, target, known):
            return makes(target)

    with pytest.raises(PluginError, match=rf"^Objective 'effort': predicted_channels\(\) {said}"):
        walk(8.0, 0.8, Odd())
