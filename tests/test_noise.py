"""The microphone and the objective `noise`, in their first, plain version."""

from __future__ import annotations

import numpy as np
import pytest

from hts import plugins
from hts.contracts import PhysicsSample
from hts_noise.microphone import Microphone, MicrophoneParameters, a_weighting, contact_seconds, pulse
from hts_noise.objective import Noise

QUIET = MicrophoneParameters(reading_noise=0.0, resolution=0.0, step_scatter=0.0)


@pytest.fixture(scope="module")
def spec():
    return plugins.load().make_robot("go1").spec


def heard(spec, parameters, touchdown_speed: float | None, joint_speed: float = 0.0, steps: int = 200) -> np.ndarray:
    """Levels at each millisecond; one foot of 0.55 kg touches down after 10 ms."""
    made, levels = Microphone(parameters, spec), []
    made.reset(1, np.random.default_rng(0))
    joints, feet = np.zeros((1, spec.num_joints)), np.zeros((1, 4))
    for step in range(steps):
        force = feet.copy()
        force[0, 0] = 50.0 if touchdown_speed is not None and step >= 10 else 0.0
        speed = np.full((1, 4), touchdown_speed or 0.0)
        made.step(PhysicsSample(joints, joints + joint_speed, force, speed, feet + 0.55, 0.001))
        levels.append(made.read()["sound_level"][0])
    return np.array(levels)


def test_a_weighting_is_one_at_a_kilohertz_and_20_db_down_at_100_hertz():
    assert a_weighting(1000.0) == pytest.approx(1.0, abs=2e-3)
    assert 20 * np.log10(a_weighting(100.0)) == pytest.approx(-19.1, abs=0.1)


def test_a_rubber_foot_touches_the_floor_for_about_8_milliseconds():
    assert contact_seconds(0.5, 0.35, 8e6, 0.023) == pytest.approx(8e-3, rel=0.1)


def test_a_pulse_has_its_impulse_at_low_frequency_and_nothing_at_its_first_null():
    assert pulse(0.0, 2.0, 0.008) == pytest.approx(2.0)
    assert pulse(1.5 / 0.008, 2.0, 0.008) == pytest.approx(0.0, abs=1e-12)  # cos(1.5 pi) = 0
    assert pulse(0.5 / 0.008, 2.0, 0.008) == pytest.approx(2.0 * np.pi / 4)


def test_the_room_alone_has_the_rooms_level(spec):
    assert heard(spec, QUIET, None) == pytest.approx(38.0)


def test_the_reference_step_has_its_level(spec):
    assert heard(spec, QUIET, 0.4).max() == pytest.approx(67.5, abs=1.5)  # part of it has decayed by then


def test_half_the_touchdown_speed_is_at_least_6_db_quieter(spec):
    # impulse halves (6 dB), and the contact lasts longer, which takes away high frequencies
    louder, quieter = heard(spec, QUIET, 0.8).max(), heard(spec, QUIET, 0.4).max()
    assert 6.0 <= louder - quieter < 12.0


def test_drives_are_6_db_louder_at_twice_the_speed(spec):
    parameters = QUIET.model_copy(update={"room_level": 30.0, "drive_level": 55.0})
    slow, fast = (heard(spec, parameters, None, speed, steps=1500)[-1] for speed in (5.0, 10.0))
    assert fast - slow == pytest.approx(6.02, abs=0.05)
    assert slow == pytest.approx(55.0 + 10 * np.log10(12), abs=0.05)  # twelve drives


def test_quieter_by_3_db_is_half_the_sound_energy():
    comparison = Noise().compare({"sound_energy": 1e6}, {"sound_energy": 2e6})
    assert comparison.improvement == pytest.approx(3.01, abs=0.01)
    assert comparison.metrics["equivalent_level"] == pytest.approx(60.0)
