"""The objective `noise`: its reward, its score, what a candidate counts with, its analytic stand-in."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from pydantic import ValidationError

from hts.channels import Channel
from hts.config import Command, ScheduleConfig
from hts.evaluation.segments import cut
from hts.recordings.recording import Recording, Series
from hts_noise.objective import Noise, NoiseSettings
from hts_noise.proxy import contact_motion


def recording(level, speed: float = 0.8, seconds: int = 4) -> Recording:
    """A robot at a constant speed; level: repeated to the end, dB(A)."""
    count = 50 * seconds
    base = np.zeros((count, 3))
    base[:, 0] = speed
    series = {
        "base_velocity": Series(Channel("base_velocity", "m/s", (3,)), base),
        "sound_level": Series(Channel("sound_level", "dB(A)"), np.resize(level, count)),
    }
    return Recording(
        robot="r",
        world="w",
        policy_hash="p",
        iteration=0,
        joint_names=(),
        kp=(),
        kd=(),
        rate_hz=50.0,
        schedule=ScheduleConfig(commands=(Command(seconds=seconds, vx=0.8),)),
        idle={"sound_level": 38.0},
        clock="simulated",
        time=np.arange(count) / 50,
        channels=series,
        mass_kg=10.0,
    )


def score(level, speed: float = 0.8):
    """Means over the segments, as `compare` gets them."""
    scores = Noise().score(cut([recording(level, speed)]))
    assert all(values.shape == (2,) for values in scores.values())  # the first 2 s are not judged
    return {name: float(values.mean()) for name, values in scores.items()}


def test_the_mean_level_is_that_of_the_mean_energy_not_the_mean_of_decibels():
    # half the time 60 dB, half 70 dB: 10 log10((10^6 + 10^7)/2) = 67.4, not 65
    comparison = Noise().compare(score([60.0, 70.0]), score([60.0]))
    assert comparison.metrics["mean_level"] == pytest.approx(67.40, abs=0.01)
    assert comparison.improvement == pytest.approx(-7.40, abs=0.01)


def test_a_loud_second_is_not_made_up_for_by_a_quiet_one():
    # one of two segments 10 dB up, the other 10 dB down: 10 log10((10 + 0.1)/2) = 7.03 dB louder than both at 60
    mixed = Noise().score(cut([recording(np.repeat([70.0, 50.0], 50))]))
    means = {name: float(values.mean()) for name, values in mixed.items()}
    assert Noise().compare(means, score([60.0])).improvement == pytest.approx(-7.03, abs=0.01)


def test_half_the_energy_is_3_decibels_quieter_and_larger_is_better():
    comparison = Noise().compare(score([60.0]), score([63.01]))
    assert comparison.improvement == pytest.approx(3.01)
    assert comparison.metrics["loud_improvement"] == pytest.approx(3.01)
    assert Noise.unit == "dB(A)"


def test_a_steady_level_a_decibel_lower_is_a_decibel_of_improvement_whatever_the_level():
    for level in (45.0, 88.0):
        assert Noise().compare(score([level - 1]), score([level])).improvement == pytest.approx(1.0)


@pytest.mark.parametrize(("loud_samples", "level"), [(4, 60.0), (6, 80.0)])
def test_the_loud_level_is_exceeded_during_a_tenth_of_the_time(loud_samples, level):
    # 4 of 50 samples are 8 %, 6 are 12 %
    levels = np.full(50, 60.0)
    levels[10 : 10 + loud_samples] = 80.0
    assert score(levels)["loud_level"] == pytest.approx(level)


def test_walking_slower_is_not_quieter_per_metre():
    # 0.73 m/s instead of 0.8 at the same level: 10 log10(0.73/0.8) = -0.40 dB per metre
    comparison = Noise().compare(score([57.0], speed=0.73), score([60.0], speed=0.8))
    assert comparison.improvement == pytest.approx(3.0)
    assert comparison.metrics["per_metre_improvement"] == pytest.approx(2.60, abs=0.01)
    assert comparison.selection_score == comparison.metrics["per_metre_improvement"]


def test_walking_faster_does_not_count_for_more_than_the_level():
    comparison = Noise().compare(score([57.0], speed=0.85), score([60.0], speed=0.8))
    assert comparison.selection_score == comparison.improvement == pytest.approx(3.0)


def test_the_level_alone_can_be_what_counts():
    objective = Noise(NoiseSettings(criterion="mean"))
    comparison = objective.compare(score([57.0], speed=0.73), score([60.0], speed=0.8))
    assert comparison.selection_score == pytest.approx(3.0)


def test_no_valid_segment_is_no_number_and_no_crash():
    scores = Noise().score(cut([recording([60.0], speed=0.2)]))
    assert {name: len(values) for name, values in scores.items()} == dict.fromkeys(scores, 0)


def test_the_reward_is_minus_the_standardised_level():
    prediction = torch.tensor([[1.5, -0.5]])
    assert torch.equal(Noise().reward(prediction), torch.tensor([[-1.5, 0.5]]))


def test_the_model_reads_the_inputs_and_predicts_the_level():
    for settings in (NoiseSettings(), NoiseSettings(torque=True, hidden=8, products=False)):
        objective = Noise(settings)
        choice = objective.measurement_model()
        assert choice.name == "footfall_level" and objective.target.name == "sound_level"
        assert ("joint_torque" in objective.inputs) == settings.torque
    assert choice.settings == {"hidden": 8, "products": False}


def test_the_stand_in_is_load_times_squared_speed_leg_by_leg():
    velocity = torch.tensor([1.0, 2.0, 0.0, 3.0])  # two legs of two joints: 1 + 4 = 5 and 9
    force = torch.tensor([10.0, 2.0])
    assert contact_motion(force, velocity) == pytest.approx(10 * 5 + 2 * 9)


def test_a_leg_in_the_air_is_silent_whatever_its_sensor_drifts_to():
    velocity = torch.tensor([1.0, 2.0, 0.0, 3.0])
    assert contact_motion(torch.tensor([0.0, -4.0]), velocity) == 0.0


def test_joints_that_are_no_legs_count_for_every_foot():
    assert contact_motion(torch.tensor([1.0, 2.0]), torch.tensor([1.0, 1.0, 2.0])) == pytest.approx(3 * 6)


def test_the_stand_in_is_one_number_per_world():
    channels = {"foot_force": torch.rand(2, 5, 4), "joint_velocity": torch.rand(2, 5, 12)}
    assert Noise().proxy(channels).shape == (2, 5)


@pytest.mark.parametrize("settings", [{"criterion": "peak"}, {"weights": []}, {"loud": 1}])
def test_a_wrong_setting_is_refused_by_name(settings):
    with pytest.raises(ValidationError, match=next(iter(settings))):
        NoiseSettings.model_validate(settings)
