"""One sample that no machine makes must not rule a fit."""

import numpy as np
import pytest

from hts.contracts import RobotSpec
from hts.errors import RecordingError
from hts.measurement.checks import predict
from hts.measurement.linear import Linear, LinearSettings
from hts.measurement.outliers import masked_split, told, without_outliers
from hts.measurement.scoring import r2
from hts.recordings.recording import Series
from hts.testing.known_signals import SIGNALS, known_heat

CHANNELS = ("effort", "rate", "heat")


def spoiled(recording, channel, places, value):
    values = recording.values(channel).copy()
    for place in places:
        values[(place, *([0] * (values.ndim - 1)))] = value
    return recording.replace(
        channels={**recording.channels, channel: Series(recording.channels[channel].channel, values)}, id="r"
    )


def test_a_sound_recording_is_left_as_it_is():
    one = known_heat(1, id="r")
    parts, masked = without_outliers([one], CHANNELS)
    assert parts == [[one]] and masked.samples == 0


@pytest.mark.parametrize("channel", CHANNELS)
@pytest.mark.parametrize("value", [1e4, -1e9])
def test_a_recording_is_cut_at_a_gross_outlier_and_it_is_counted(channel, value):
    parts, masked = without_outliers([spoiled(known_heat(1), channel, [400], value)], CHANNELS)
    assert [one.id for one in parts[0]] == ["r[0:400]", "r[401:1000]"]
    assert masked.samples == 1 and masked.why[channel][:2] == (1, pytest.approx(value))
    assert told(masked).startswith("1 sample that no machine makes left out") and f"'{channel}' 1" in told(masked)


def test_one_outlier_among_very_many_samples_no_longer_ruins_the_fit():
    training, new = [known_heat(seed, id=f"r{seed}") for seed in range(1, 9)], known_heat(50, "stranger")
    bad = [spoiled(training[0], "heat", [500], 2.9e5), *training[1:]]

    def score(recordings):
        model = Linear(LinearSettings(lag_seconds=0.2), SIGNALS)
        model.fit(recordings)
        return r2(new.values("heat")[50:], predict(model, new)[50:])

    assert score(bad) < 0.5
    assert score(masked_split(bad, [], CHANNELS)[0]) > 0.999


def test_limits_of_the_robot_find_what_the_range_does_not():
    r = known_heat(1, id="r")
    speed = Series(r.channels["rate"].channel, r.values("rate"))
    one = r.replace(channels={"joint_rate": speed}, id="r")
    one = spoiled(one, "joint_rate", [100], 20.0)
    spec = RobotSpec.log_only(
        "fake",
        ("x", "y", "z"),
        torque_limit=(1.0,) * 3,
        velocity_limit=(4.0,) * 3,
        position_limit=((-9.0, 9.0),) * 3,
        rate_hz=50.0,
    )
    assert without_outliers([one], ("joint_rate",))[1].samples == 0
    assert without_outliers([one], ("joint_rate",), spec)[1].samples == 1


def test_a_channel_that_is_nearly_always_the_same_is_no_reason():
    one = known_heat(1, id="r")
    values = np.zeros_like(one.values("effort"))
    values[500:510] = 40.0  # a push
    pushed = one.replace(channels={**one.channels, "effort": Series(one.channels["effort"].channel, values)}, id="r")
    assert without_outliers([pushed], ("effort",))[1].samples == 0


def test_both_sides_of_a_split_are_masked_and_nothing_left_is_an_error():
    good, bad = known_heat(1, id="a"), spoiled(known_heat(2), "heat", [300], 1e6)
    training, held, masked = masked_split([good], [bad], CHANNELS)
    assert training == [good] and [one.id for one in held] == ["r[0:300]", "r[301:1000]"] and masked.samples == 1
    short = spoiled(known_heat(3, seconds=1.5), "heat", [37], 1e6)
    with pytest.raises(RecordingError, match="Nothing is left to fit to: 1 sample"):
        masked_split([short], [good], CHANNELS)
