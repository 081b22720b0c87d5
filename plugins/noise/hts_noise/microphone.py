"""The instrument `microphone`: footfalls, drives and the room, as an A-weighted fast sound level at 1 m.

A first, plain version: one set of ringing modes for floor, shank and shell, no reflections, no direction.

    touchdown   Hertz contact of a rubber foot: k = (4/3) E* sqrt(R_f), d_m = (5 m v^2 / 4 k)^(2/5), t_c = 2.94 d_m / v
    pulse       |F(f)| = J |cos(pi f t_c)| / |1 - 4 f^2 t_c^2|, J = (1 + e) m v       (half-sine)
    modes       p_k(t) = (G/r) |F(f_k)| exp(-s_k t) sin(2 pi f_k t), s_k = 2 pi zeta f_k
    drives      p_d^2 = sum_i p_r^2 (q'_i / q'_r)^2 [1 + kappa (tau_i / tau_limit)^2]
    level       exponential mean of W^2 p^2 over 125 ms, in dB over (20 uPa)^2

v and m are the foot's normal speed just before contact and its effective mass; v and Hertz are used and not the
simulator's peak force, which depends on its contact settings. G is set once by a reference step.
No absolute level of a walking robot of this kind was found: levels are placeholders, differences are what counts.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from pydantic import Field

from hts.channels import Channel
from hts.config import Config
from hts.contracts import Instrument, PhysicsSample, RobotSpec

REFERENCE_PRESSURE = 20e-6  # Pa
FAST_SECONDS = 0.125  # IEC 61672, time weighting F
REFERENCE_STEP = (0.4, 0.55)  # m/s and kg: the step that is `step_level` loud
CONTACT_NEWTONS = 1.0


class MicrophoneParameters(Config):
    """Numbers of the sound; sources: estimates (E) unless named."""

    foot_modulus: float = Field(
        8e6, ge=5e6, le=20e6, description="E* of the foot pad, Pa. Range 5e6 to 20e6, soft to worn. E"
    )
    foot_radius: float = Field(
        0.023, ge=0.01, le=0.05, description="R_f, m. Range 0.01 to 0.05. mujoco_menagerie 0.023"
    )
    restitution: float = Field(0.25, ge=0.1, le=0.4, description="e, 1. Range 0.1 to 0.4. E")
    modes: int = Field(8, ge=6, le=10, description="ringing modes, evenly spaced in log f. Range 6 to 10. E")
    low: float = Field(120.0, ge=60, le=400, description="lowest mode, Hz. Range 60 to 400. E")
    high: float = Field(4000.0, ge=1000, le=8000, description="highest mode, Hz. Range 1000 to 8000. E")
    damping: float = Field(0.05, ge=0.02, le=0.10, description="zeta of every mode, 1. Range 0.02 to 0.10. E")
    step_level: float = Field(
        67.5, ge=60, le=75, description="peak fast level at 1 m of a step of 0.4 m/s, 0.55 kg, dB(A). Range 60 to 75. E"
    )
    step_scatter: float = Field(
        2.5,
        ge=0,
        le=4,
        description="sigma of a step's level, dB. Range 0 to 4. E, from r = 0.42 of contact pressure and peak sound",
    )
    drive_level: float = Field(45.0, ge=30, le=55, description="of one drive at 5 rad/s, dB(A). Range 30 to 55. E")
    drive_speed: float = Field(5.0, ge=1, le=10, description="q'_r, rad/s. Range 1 to 10. By definition")
    drive_load: float = Field(0.5, ge=0, le=1, description="kappa, 1. Range 0 to 1. E")
    room_level: float = Field(38.0, ge=30, le=45, description="without the robot walking, dB(A). Range 30 to 45. E")
    reading_noise: float = Field(0.3, ge=0, le=2, description="sigma of a reading, dB. Range 0 to 2. E")
    resolution: float = Field(0.1, ge=0, le=1, description="step of a reading, dB; 0 leaves it out. Range 0 to 1. E")


def a_weighting(frequency):
    """Amplitude factor W of A-weighting at a frequency, Hz (IEC 61672); 1 at 1 kHz."""
    f2 = np.square(np.asarray(frequency, dtype=float))
    below = (f2 + 20.6**2) * np.sqrt((f2 + 107.7**2) * (f2 + 737.9**2)) * (f2 + 12194.0**2)
    return 1.259 * 12194.0**2 * f2**2 / below


def contact_seconds(speed, mass, modulus, radius):
    """t_c of a Hertz contact, s: 2.94 d_m / v. speed m/s, mass kg, modulus Pa, radius m."""
    stiffness = 4 / 3 * modulus * np.sqrt(radius)
    return 2.94 * (5 * mass * np.square(speed) / (4 * stiffness)) ** 0.4 / speed


def pulse(frequency, impulse, seconds):
    """|F(f)| of a half-sine pulse, N s: its impulse (N s) at low frequency, falling beyond 1 / t_c."""
    x = 2 * frequency * seconds
    # cos(pi x / 2) / (1 - x^2) has the finite limit pi / 4 at x = 1
    apart = np.abs(1 - x * x) > 1e-6
    value = np.where(apart, np.abs(np.cos(np.pi * x / 2)) / np.abs(np.where(apart, 1 - x * x, 1)), np.pi / 4)
    return impulse * value


class Microphone(Instrument):
    """Sound level of W robots."""

    channels = (Channel("sound_level", "dB(A)", (), "fast A-weighted level 1 m from the robot"),)

    def __init__(self, parameters: MicrophoneParameters, spec: RobotSpec) -> None:
        self.p = parameters
        self._torque_limit = np.array(spec.torque_limit)
        self.frequencies = np.geomspace(parameters.low, parameters.high, parameters.modes)
        self._decay = 2 * np.pi * parameters.damping * self.frequencies  # s_k, 1/s
        self._gain = 1.0
        # One step's energy, sum (W A)^2 / (4 s), spread over the meter's 125 ms, is its peak level.
        energy = (self._strike(*(np.array([value]) for value in REFERENCE_STEP)) / (4 * self._decay)).sum()
        wanted = REFERENCE_PRESSURE**2 * 10 ** (parameters.step_level / 10) * FAST_SECONDS
        self._gain = float(np.sqrt(wanted / energy))
        self.reset(1, np.random.default_rng(0))

    def reset(self, num_worlds: int, rng: np.random.Generator) -> None:
        self._rng = rng
        self._ringing = np.zeros((num_worlds, self.p.modes))  # (W_k A_k)^2 left of all steps so far, Pa^2
        self._room = REFERENCE_PRESSURE**2 * 10 ** (self.p.room_level / 10)
        self._mean = np.full(num_worlds, self._room)  # of squared pressure over 125 ms, Pa^2
        self._touching: np.ndarray | None = None

    def step(self, sample: PhysicsSample) -> None:
        p, dt = self.p, sample.dt
        touching = sample.foot_force > CONTACT_NEWTONS
        if self._touching is not None:
            self._land(sample, touching & ~self._touching)
        self._touching = touching
        kept = np.exp(-2 * self._decay * dt)
        steps = (self._ringing * ((1 - kept) / (4 * self._decay))).sum(axis=1) / dt
        self._ringing *= kept
        load = 1 + p.drive_load * np.square(sample.motor_torque / self._torque_limit)
        whine = (np.square(sample.joint_velocity / p.drive_speed) * load).sum(axis=1)
        squared = steps + self._room + REFERENCE_PRESSURE**2 * 10 ** (p.drive_level / 10) * whine
        self._mean += (squared - self._mean) * (dt / FAST_SECONDS)

    def read(self) -> Mapping[str, np.ndarray]:
        level = 10 * np.log10(self._mean / REFERENCE_PRESSURE**2)
        level = level + self.p.reading_noise * self._rng.standard_normal(level.shape)
        step = self.p.resolution
        return {"sound_level": np.rint(level / step) * step if step > 0 else level}

    def idle(self) -> Mapping[str, float]:
        return {"sound_level": self.p.room_level}

    def describe(self) -> Mapping[str, Any]:
        return self.p.model_dump(mode="json")

    def _land(self, sample: PhysicsSample, landing: np.ndarray) -> None:
        """Add the ringing of feet that touch down in this step, (W, F)."""
        landing = landing & (sample.foot_speed > 1e-3)
        if not landing.any():
            return
        worlds, feet = np.nonzero(landing)
        added = self._strike(sample.foot_speed[worlds, feet], sample.foot_mass[worlds, feet])
        scatter = 10 ** (self.p.step_scatter * self._rng.standard_normal(len(worlds)) / 10)
        np.add.at(self._ringing, worlds, added * scatter[:, None])

    def _strike(self, speed: np.ndarray, mass: np.ndarray) -> np.ndarray:
        """(W_k A_k)^2 of each mode for each step, (steps, modes), Pa^2; speed m/s and mass kg are (steps,)."""
        seconds = contact_seconds(speed, mass, self.p.foot_modulus, self.p.foot_radius)
        impulse = (1 + self.p.restitution) * mass * speed
        spectrum = pulse(self.frequencies, impulse[:, None], seconds[:, None])
        return np.square(self._gain * a_weighting(self.frequencies) * spectrum)
