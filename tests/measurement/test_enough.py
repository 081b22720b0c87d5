"""Whether recordings are enough, on data whose answer is known."""

from __future__ import annotations

import json

import numpy as np
import pytest

from hts.channels import Channel
from hts.errors import PluginError, RecordingError
from hts.measurement.enough import enough
from hts.measurement.linear import Linear
from hts.recordings import Series
from hts.testing.known_signals import KnownHeat, known_heat


@pytest.fixture(scope="module")
def plenty():
    """Three policies, two speeds, 40 s each: 240 s."""
    return [
        known_heat(seed, policy, seconds=40.0, speed=speed, gait=gait)
        for seed, (policy, gait, speed) in enumerate(
            (policy, gait, speed) for policy, gait in (("a", 0.8), ("b", 1.0), ("c", 1.3)) for speed in (0.5, 0.8)
        )
    ]


def test_three_policies_at_two_speeds_are_enough(plenty):
    found = enough(KnownHeat(), plenty, speeds=[0.5, 0.8])
    assert found.missing == ()
    assert (found.policies, found.seconds, found.speeds) == (3, 240.0, {0.5: 120.0, 0.8: 120.0})
    assert found.by_policy and {one.policy for one in found.held_out} == {"a", "b", "c"}
    assert found.r2 > 0.9 and all(abs(one.mean_error) < 1.0 for one in found.held_out)
    json.dumps(found.as_json(), allow_nan=False)


def test_a_speed_at_which_nobody_walked_is_missing(plenty):
    (missing,) = enough(KnownHeat(), plenty, speeds=[0.5, 1.1]).missing
    assert missing == "record 20 s more at 1.1: there are 0 s, expected 20"


def test_seconds_at_speeds_beside_the_asked_one_are_summed(plenty):
    """120 s at 0.5 and 120 s at 0.8 of `plenty`; beside them 12 s at 0.78 and 14 s at 1.02 and at 1.05."""
    more = [known_heat(n, "a", seconds=s, speed=v) for n, s, v in ((9, 12.0, 0.78), (10, 14.0, 1.02), (11, 14.0, 1.05))]
    assert enough(KnownHeat(), [*plenty, *more], speeds=[0.8, 1.03]).missing == ()
    (missing,) = enough(KnownHeat(), [*plenty, *more], speeds=[1.0]).missing
    assert missing == "record 6 s more at 1: there are 14 s, expected 20"


def test_one_short_recording_lacks_everything():
    found = enough(KnownHeat(), [known_heat(0, seconds=20.0)])
    assert not found.by_policy
    assert found.missing[0] == "record 100 s more: there are 20 s, expected 120"
    assert "record other policies, 3 at least: there are 1" in found.missing[1]


def test_a_policy_that_nobody_named_is_no_policy():
    found = enough(KnownHeat(), [known_heat(0, "", seconds=130.0)])
    assert any("no policy is named (policy_hash in the mapping)" in line for line in found.missing)


def test_joints_that_all_follow_one_phase_ask_for_exploration(plenty):
    """Each input is a multiple of one sine: one direction of six."""
    steady = []
    for one in plenty:
        wave = np.sin(2 * np.pi * 2.2 * one.time)[:, None] * np.array([1.0, -2.0, 0.5])
        channels = {name: Series(one.channels[name].channel, wave) for name in ("effort", "rate")}
        steady.append(one.replace(channels={**one.channels, **channels}))
    found = enough(KnownHeat(), steady)
    assert (found.directions, found.inputs) == (1, 6)
    assert any(line.startswith("record with exploration noise") for line in found.missing)


def test_inputs_that_move_each_for_itself_are_as_many_directions_whatever_their_units(plenty):
    rng, free = np.random.default_rng(0), []
    for one in plenty:
        series = {name: rng.standard_normal((one.num_samples, 3)) * [1.0, 10.0, 1000.0] for name in ("effort", "rate")}
        channels = {name: Series(one.channels[name].channel, values) for name, values in series.items()}
        free.append(one.replace(channels={**one.channels, **channels}))
    found = enough(KnownHeat(), free)  # each input has a sixth of the variance: five of them are 83 %
    assert (found.directions, found.inputs) == (6, 6)


def test_a_gauge_that_shows_something_else_is_not_trusted(plenty):
    random = np.random.default_rng(0)
    noise = [
        one.replace(
            channels={
                **one.channels,
                "heat": Series(one.channels["heat"].channel, random.normal(5, 1, one.num_samples)),
            }
        )
        for one in plenty
    ]
    found = enough(KnownHeat(), noise)
    assert found.r2 < 0.2
    assert any("of the variance of policies it had not seen, expected 0.6" in line for line in found.missing)


def test_a_policy_whose_level_is_missed_is_named(plenty):
    """Policy c is worn: it heats more than its motion tells."""
    worn = []
    for one in plenty:
        if one.policy_hash == "c":
            heat = Series(one.channels["heat"].channel, one.values("heat") + 30.0)
            one = one.replace(channels={**one.channels, "heat": heat})
        worn.append(one)
    found = enough(KnownHeat(), worn)
    assert any("the level of policy c is missed by -" in line for line in found.missing), found.missing


def test_policies_behind_a_gauge_that_stopped_are_told_of(plenty):
    stopped = []
    for one in plenty:
        heat = one.values("heat").copy()
        heat[20:] = 1.9
        stopped.append(one.replace(channels={**one.channels, "heat": Series(one.channels["heat"].channel, heat)}))
    found = enough(KnownHeat(), stopped)
    assert found.r2 is None and "record longer: too little is left to test a model on" in found.missing


def test_a_fit_that_fails_is_one_line(plenty, monkeypatch):
    def fails(model, recordings, how):
        return 1 / 0

    monkeypatch.setattr(Linear, "learn", fails)
    with pytest.raises(PluginError, match="'linear', fitted with policy . held out, failed, ZeroDivision") as caught:
        enough(KnownHeat(), plenty)
    assert "\n" not in str(caught.value)


def test_where_no_speed_is_stated_nothing_is_said_about_speeds_and_the_rest_may_be_enough(plenty):
    unknown = [one.replace(notes={"schedule": "not stated in the mapping"}) for one in plenty]
    found = enough(KnownHeat(), unknown)
    assert (found.missing, found.unsaid, found.speeds, found.verdict) == ((), (), {}, True)
    found = enough(KnownHeat(), unknown, speeds=[0.5])
    (line,) = found.unsaid
    assert line.startswith("whether there are 20 s at 0.5: 240 s are of recordings that state no commanded speed")
    assert (found.missing, found.verdict) == ((), None)


def test_a_speed_that_recordings_without_speeds_cannot_fill_up_is_missing(plenty):
    """None of 240 s is at 1.1; 14 s more are of nobody knows which speed, then 40 s."""
    short = known_heat(9, "a", seconds=14.0, notes={"schedule": "not stated in the mapping"})
    found = enough(KnownHeat(), [*plenty, short], speeds=[1.1])
    assert (found.unsaid, found.verdict) == ((), False)
    assert found.missing == ("record 20 s more at 1.1: there are 0 s, expected 20",)
    longer = known_heat(9, "a", seconds=40.0, notes={"schedule": "not stated in the mapping"})
    found = enough(KnownHeat(), [*plenty, longer], speeds=[1.1, 0.5])
    assert (found.missing, len(found.unsaid), found.verdict) == ((), 1, None)


def test_recordings_that_lack_an_input_are_refused(plenty):
    channels = {name: series for name, series in plenty[0].channels.items() if name != "rate"}
    with pytest.raises(RecordingError, match="No channel named 'rate'"):
        enough(KnownHeat(), [plenty[0].replace(channels=channels)])


@pytest.mark.parametrize("policies", [1, 3])
def test_a_target_in_another_unit_is_refused_with_the_stored_recording_and_what_to_do(plenty, policies):
    other = [
        one.replace(
            channels={**one.channels, "heat": Series(Channel("heat", "mW"), 1000 * one.values("heat"))},
            policy_hash=str(number % policies),
        ).replace(id=f"r{number}")
        for number, one in enumerate(plenty)
    ]
    with pytest.raises(RecordingError, match="^Recording r0: 'heat' is in mW, the model predicts W. Import .* in W: "):
        enough(KnownHeat(), other)


def test_a_part_of_a_recording_is_named_by_its_recording(plenty):
    """At another rate than the first, of one policy: the end of each recording is held out."""
    slow = plenty[1].replace(rate_hz=25.0, policy_hash=plenty[0].policy_hash).replace(id="slow")
    with pytest.raises(RecordingError, match=r"Recording slow\[0:\d+\] has 25 Hz, the model is for"):
        enough(KnownHeat(), [plenty[0].replace(id="first"), slow])


def test_a_walk_that_is_there_twice_counts_once_and_is_told(plenty):
    copy = plenty[0].replace(policy_hash="d", notes={"source": "copy.csv"})
    once, found = enough(KnownHeat(), plenty), enough(KnownHeat(), [*plenty, copy])
    assert (found.seconds, found.policies, found.r2) == (once.seconds, once.policies, once.r2)
    (missing,) = found.missing
    assert "(no source) and" in missing and "(copy.csv) hold the same samples, so one walk counts twice" in missing
