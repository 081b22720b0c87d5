"""Sound of footfalls and of drives, and how a sound-level meter weighs them. Functions of arrays; SI units.

docs/noise.md gives every formula with its number and its source.
"""

from __future__ import annotations

import numpy as np

REFERENCE_PRESSURE = 20e-6  # Pa: 0 dB (ISO 1683, sound in air)
FAST_SECONDS = 0.125  # time weighting F (IEC 61672-1)
HERTZ_TIME = 2.94  # contact time over (compression / speed): (4/5) B(2/5, 1/2) = 2.943 for F ~ compression^(3/2)


Values = float | np.ndarray
"""A number or an array; functions of numbers alone return a NumPy number, which has the methods of an array."""


def a_weighting(frequency: Values) -> np.ndarray:
    """Amplitude factor W of A-weighting at a frequency, Hz; 1 at 1 kHz. (IEC 61672-1, analytic form.)

    W = 1.259 * 12194^2 f^4 / [(f^2 + 20.6^2) sqrt((f^2 + 107.7^2)(f^2 + 737.9^2)) (f^2 + 12194^2)]
    """
    f2 = np.square(np.asarray(frequency, dtype=float))
    below = (f2 + 20.6**2) * np.sqrt((f2 + 107.7**2) * (f2 + 737.9**2)) * (f2 + 12194.0**2)
    return 1.259 * 12194.0**2 * f2**2 / below


def decibels(squared_pressure: Values) -> np.ndarray:
    """Level of a mean squared sound pressure, Pa^2, in dB over (20 uPa)^2."""
    return 10 * np.log10(squared_pressure / REFERENCE_PRESSURE**2)


def squared_pressure(level: Values) -> np.ndarray:
    """Mean squared sound pressure, Pa^2, of a level, dB: the inverse of `decibels`."""
    return REFERENCE_PRESSURE**2 * 10 ** (np.asarray(level, dtype=float) / 10)


def contact_stiffness(modulus: float, radius: float) -> float:
    """(1) k of F = k d^(3/2) for an elastic ball on a rigid plane, N/m^1.5. modulus E*: Pa; radius: m (Hertz 1882)."""
    return 4 / 3 * modulus * np.sqrt(radius)


def compression(speed: Values, mass: Values, stiffness: float) -> np.ndarray:
    """(2) Largest compression of a mass (kg) that arrives with a speed (m/s), m.

    Energy: m v^2 / 2 = (2/5) k d^(5/2), so d = (5 m v^2 / (4 k))^(2/5); the peak force k d^(3/2) goes with v^1.2.
    """
    return (5 * mass * np.square(speed) / (4 * stiffness)) ** 0.4


def contact_seconds(speed: Values, mass: Values, stiffness: float) -> np.ndarray:
    """(3) How long the contact lasts, s: 2.94 d / v, so it goes with v^-0.2. speed m/s above 0, mass kg."""
    return HERTZ_TIME * compression(speed, mass, stiffness) / speed


def pulse_spectrum(frequency: Values, impulse: Values, seconds: Values) -> np.ndarray:
    """(4) |F(f)| of a half-sine force pulse, N s: its impulse (N s) at low frequency, falling with f^-2 beyond 1 / t_c.

    J |cos(pi f t_c)| / |1 - 4 f^2 t_c^2|, whose limit at f t_c = 1/2 is J pi / 4.
    """
    x = 2 * frequency * seconds
    apart = np.abs(1 - x * x) > 1e-6
    value = np.where(apart, np.abs(np.cos(np.pi * x / 2)) / np.abs(np.where(apart, 1 - x * x, 1)), np.pi / 4)
    return impulse * value


def decay_rate(frequency: Values, damping: Values) -> np.ndarray:
    """(5) s of the envelope exp(-s t) of a mode, 1/s: 2 pi zeta f. frequency Hz, damping ratio zeta 1."""
    return 2 * np.pi * damping * np.asarray(frequency, dtype=float)


def ringing_energy(squared_amplitude: Values, decay: Values, start: Values, end: Values) -> np.ndarray:
    """(6) Integral of p^2 over [start, end] s after the strike, Pa^2 s, for p = A exp(-s t) sin(2 pi f t), many cycles.

    A^2/(4 s) [exp(-2 s start) - exp(-2 s end)], since sin^2 averages 1/2; A^2/(4 s) in all.
    """
    return squared_amplitude / (4 * decay) * (np.exp(-2 * decay * start) - np.exp(-2 * decay * end))


def fast_ringing(decay: Values, seconds: Values) -> np.ndarray:
    """(7) What a ringing of A^2 = 1 adds, after so many seconds, to the squared pressure that the meter shows, Pa^2.

    The meter's m follows m' = (p^2 - m) / tau. With p^2 = exp(-2 s t) / 2 from t = 0 on, m(0) = 0:
    m(t) = [exp(-2 s t) - exp(-t/tau)] / (2 (1 - 2 s tau)). Modes here have 2 s tau > 1.8, so nothing divides by 0.
    """
    return (np.exp(-2 * decay * seconds) - np.exp(-seconds / FAST_SECONDS)) / (2 * (1 - 2 * decay * FAST_SECONDS))


def peak_fast_level(squared_amplitudes: np.ndarray, decays: np.ndarray) -> float:
    """Highest fast level of one lone strike with these squared amplitudes (K,), Pa^2, and decays (K,), 1/s; in dB."""
    seconds = np.linspace(0, 2 * FAST_SECONDS, 2001)
    return float(decibels((squared_amplitudes * fast_ringing(decays, seconds[:, None])).sum(axis=1).max()))


def drive_whine(
    velocity: np.ndarray,
    torque: np.ndarray,
    level: float,
    speed: float,
    exponent: float,
    load_share: float,
    torque_limit: Values,
) -> np.ndarray:
    """(8) A-weighted squared pressure of all drives together, Pa^2. velocity rad/s, torque N m: (..., J) -> (...,).

    p_d^2 = sum_i p_r^2 (|q'_i| / q'_r)^a [1 + kappa (tau_i / tau_limit)^2], p_r from `level`, one drive's at q'_r.
    """
    load = 1 + load_share * np.square(torque / torque_limit)
    return squared_pressure(level) * ((np.abs(velocity) / speed) ** exponent * load).sum(axis=-1)
