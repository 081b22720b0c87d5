"""The formulas behind the microphone, against tables and numbers on paper."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from scipy.special import beta

from hts_noise import acoustics as a


@pytest.mark.parametrize(
    ("frequency", "decibels"),  # the table of IEC 61672-1, at nominal frequencies
    [
        (31.5, -39.4), (63, -26.2), (125, -16.1), (250, -8.6), (500, -3.2),
        (1000, 0.0), (2000, 1.2), (4000, 1.0), (8000, -1.1), (16000, -6.6),
    ],
)  # fmt: skip
def test_a_weighting_is_that_of_the_standard(frequency, decibels):
    assert 20 * np.log10(a.a_weighting(frequency)) == pytest.approx(decibels, abs=0.15)


def test_one_pascal_is_94_decibels():
    assert a.decibels(1.0) == pytest.approx(93.98, abs=0.01)  # 20 log10(1 / 20e-6)
    assert a.squared_pressure(93.979) == pytest.approx(1.0, rel=1e-4)


def test_twice_the_energy_is_3_decibels_more():
    assert a.decibels(2 * a.squared_pressure(60.0)) == pytest.approx(63.01, abs=0.001)


FOOT = a.contact_stiffness(modulus=8e6, radius=0.023)  # 4/3 * 8e6 * sqrt(0.023) = 1.618e6


def peak_force(speed, mass=0.35):
    return FOOT * a.compression(speed, mass, FOOT) ** 1.5


def test_a_contact_takes_up_the_whole_energy_of_the_foot():
    # m v^2 / 2 = integral of k x^(3/2) from 0 to d = (2/5) k d^(5/2)
    assert 0.4 * FOOT * a.compression(0.5, 0.35, FOOT) ** 2.5 == pytest.approx(0.5 * 0.35 * 0.5**2)


def test_a_foot_of_350_g_at_half_a_metre_per_second_gives_80_newtons_for_8_milliseconds():
    assert peak_force(0.5) == pytest.approx(80, rel=0.02)
    assert a.contact_seconds(0.5, 0.35, FOOT) == pytest.approx(8e-3, rel=0.02)


def test_peak_force_goes_with_speed_to_the_1_2_and_contact_time_to_the_minus_0_2():
    assert peak_force(1.0) / peak_force(0.5) == pytest.approx(2**1.2)
    times = [a.contact_seconds(speed, 0.35, FOOT) for speed in (0.5, 1.0)]
    assert times[1] / times[0] == pytest.approx(2**-0.2)


def test_the_contact_time_of_hertz_is_an_integral_of_known_value():
    # 2 * integral of dx / sqrt(1 - x^(5/2)) from 0 to 1 = (4/5) B(2/5, 1/2)
    assert pytest.approx(0.8 * beta(0.4, 0.5), abs=0.01) == a.HERTZ_TIME


def test_a_pulse_has_its_impulse_at_low_frequency_and_nothing_at_its_first_null():
    assert a.pulse_spectrum(0.0, 2.0, 0.008) == pytest.approx(2.0)
    assert a.pulse_spectrum(1.5 / 0.008, 2.0, 0.008) == pytest.approx(0.0, abs=1e-12)  # cos(1.5 pi) = 0
    assert a.pulse_spectrum(0.5 / 0.008, 2.0, 0.008) == pytest.approx(2.0 * np.pi / 4)


@pytest.mark.parametrize("frequency", [20.0, 110.0, 430.0])
def test_a_pulse_has_the_fourier_transform_of_a_half_sine(frequency):
    time = np.linspace(0, 0.008, 20001)
    force = np.pi / 2 / 0.008 * np.sin(np.pi * time / 0.008)  # of impulse 1
    transformed = np.trapezoid(force * np.exp(-2j * np.pi * frequency * time), time)
    assert a.pulse_spectrum(frequency, 1.0, 0.008) == pytest.approx(abs(transformed), abs=1e-6)


def test_a_ringing_mode_has_the_energy_of_its_squared_amplitude_over_four_decay_rates():
    decay = a.decay_rate(500.0, 0.05)
    assert decay == pytest.approx(157.08, abs=0.01)  # 2 pi * 0.05 * 500
    assert a.ringing_energy(4.0, decay, 0.0, np.inf) == pytest.approx(4.0 / (4 * 157.08), rel=1e-4)
    time = np.linspace(0, 0.2, 400_001)
    pressure = 2.0 * np.exp(-decay * time) * np.sin(2 * np.pi * 500 * time)
    # sin^2 averages 1/2 up to (s / 2 pi f)^2 = 0.05^2
    assert np.trapezoid(pressure**2, time) == pytest.approx(a.ringing_energy(4.0, decay, 0.0, 0.2), rel=0.05**2 * 1.1)


def test_the_energy_of_frames_adds_up():
    edges = [0.0, 0.013, 0.033, 0.053]
    parts = [a.ringing_energy(1.0, 80.0, start, end) for start, end in itertools.pairwise(edges)]
    assert sum(parts) == pytest.approx(a.ringing_energy(1.0, 80.0, 0.0, 0.053))


def test_what_a_meter_shows_of_a_ringing_solves_its_equation():
    decay, dt, shown = 60.0, 1e-5, 0.0
    for step in range(5000):  # m' = (p^2 - m) / tau in small steps, p^2 at their middles
        shown += (0.5 * np.exp(-2 * decay * (step + 0.5) * dt) - shown) * dt / a.FAST_SECONDS
    assert a.fast_ringing(decay, 0.05) == pytest.approx(shown, rel=1e-3)


def test_a_short_ring_peaks_at_its_energy_spread_over_125_milliseconds():
    # nothing leaks away while a ring of 1 / (2 * 5000) s lasts: m = A^2 / (4 s tau)
    level = a.peak_fast_level(np.array([1.0]), np.array([5000.0]))
    assert level == pytest.approx(10 * np.log10(1 / (4 * 5000 * 0.125) / 4e-10), abs=0.05)


def test_drives_are_6_decibels_louder_at_twice_the_speed_and_add_as_energies():
    def level(speed, torque=0.0, joints=1, exponent=2.0):
        whine = a.drive_whine(np.full(joints, speed), np.full(joints, torque), 45.0, 5.0, exponent, 0.5, 20.0)
        return a.decibels(whine)

    assert level(5.0) == pytest.approx(45.0)
    assert level(-10.0) == pytest.approx(51.02, abs=0.01)
    assert level(50.0, exponent=2.5) == pytest.approx(70.0)  # 25 dB for a decade
    assert level(5.0, joints=12) == pytest.approx(55.79, abs=0.01)  # 10 log10(12)
    assert level(5.0, torque=-20.0) == pytest.approx(46.76, abs=0.01)  # 10 log10(1.5)
