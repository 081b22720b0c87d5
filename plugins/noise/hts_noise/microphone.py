"""The instrument `microphone`: what a sound-level meter beside a simulated robot shows, from its footfalls.

Every touchdown is a Hertz contact whose force pulse sets modes of floor, shank and shells ringing; drives whine, the
room is never silent. The meter A-weights, squares, averages exponentially over 125 ms (`fast`) and shows decibels. What
rings on is kept as squared amplitudes, so a frame is worked through in closed form, however long the modes ring.
docs/noise.md gives every formula with its number.

Steps are collected and worked through in one go when a reading is asked for, as in other instruments.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from hts.channels import Channel
from hts.contracts import Instrument, PhysicsSample, Robot, RobotSpec, Settings
from hts_noise import acoustics
from hts_noise.microphone_parameters import MicrophoneParameters

REFERENCE_STEP = (0.4, 0.55)  # m/s and kg: the step that is `step_level` loud
CHUNK = 64  # steps worked through together at most

SOUND_LEVEL = Channel("sound_level", "dB(A)", (), "fast A-weighted level (125 ms) near the robot")


def make_microphone(settings: Settings, robot: Robot) -> Microphone:
    """The factory of instrument `microphone`."""
    return Microphone(MicrophoneParameters.model_validate(dict(settings)), robot.spec)


class Microphone(Instrument):
    """Sound level of W robots, each in a room of its own."""

    channels = (SOUND_LEVEL,)

    def __init__(self, parameters: MicrophoneParameters, spec: RobotSpec) -> None:
        self.p, self.spec = parameters, spec
        self._torque_limit = np.array(spec.torque_limit)
        self._frequency = np.array(parameters.frequencies)  # (K,)
        self._decay = acoustics.decay_rate(self._frequency, np.array(parameters.dampings))  # s_k, 1/s (K,)
        self._stiffness = acoustics.contact_stiffness(parameters.foot_modulus, parameters.foot_radius)
        octaves = np.log2(self._frequency / self._frequency[0])
        self._gain = acoustics.a_weighting(self._frequency) * 10 ** (parameters.gain_slope * octaves / 20)
        speed, mass = REFERENCE_STEP
        lone = acoustics.peak_fast_level(self.strike(np.array([speed]), np.array([mass]))[0], self._decay)
        # One scale for all G_k, so that the reference step has step_level at 1 m; amplitudes fall with 1 / r.
        self._gain = self._gain * 10 ** ((parameters.step_level - lone) / 20) / parameters.distance
        self._room = acoustics.squared_pressure(parameters.room_level)
        self.reset(1, np.random.default_rng(0))

    def reset(self, num_worlds: int, rng: np.random.Generator) -> None:
        self._rng = rng
        self._ringing = np.zeros((num_worlds, len(self._decay)))  # squared amplitude of each mode now, Pa^2 (W, K)
        self._shown = np.full(num_worlds, self._room)  # the meter's m, Pa^2 (W,)
        self._touching: np.ndarray | None = None  # (W, F)
        joints, feet = (CHUNK, num_worlds, self.spec.num_joints), (CHUNK, num_worlds, len(self.spec.foot_sites))
        self._count, self._dt = 0, 0.0
        self._torque, self._velocity = np.empty(joints), np.empty(joints)
        self._force, self._speed, self._mass = np.empty(feet), np.empty(feet), np.empty(feet)
        self.energy = {name: np.zeros(num_worlds) for name in ("steps", "drives", "room")}
        """A-weighted sound exposure since reset, Pa^2 s (W,): what only a simulator knows. Never recorded."""
        self.steps = np.zeros(num_worlds, dtype=int)
        """Footfalls since reset (W,)."""
        self.seconds = 0.0
        self._told = (0.0, np.zeros(num_worlds))

    def step(self, sample: PhysicsSample) -> None:
        now = self._count
        self._torque[now], self._velocity[now] = sample.motor_torque, sample.joint_velocity
        self._force[now], self._speed[now], self._mass[now] = sample.foot_force, sample.foot_speed, sample.foot_mass
        self._count, self._dt = now + 1, sample.dt
        if self._count == CHUNK:
            self._work()

    def advance(self, samples: PhysicsSample) -> None:
        done, steps, self._dt = 0, len(samples.motor_torque), samples.dt
        while done < steps:
            count = min(steps - done, CHUNK - self._count)
            now, some = slice(self._count, self._count + count), slice(done, done + count)
            self._torque[now], self._velocity[now] = samples.motor_torque[some], samples.joint_velocity[some]
            self._force[now], self._speed[now] = samples.foot_force[some], samples.foot_speed[some]
            self._mass[now] = samples.foot_mass[some]
            self._count, done = self._count + count, done + count
            if self._count == CHUNK:
                self._work()

    def read(self) -> Mapping[str, np.ndarray]:
        self._work()
        noise = self.p.reading_noise * self._rng.standard_normal(len(self._shown))
        level = acoustics.decibels(self._shown) + self.p.calibration_error + noise
        step = self.p.resolution
        return {"sound_level": np.rint(level / step) * step if step > 0 else level}

    def idle(self) -> Mapping[str, float]:
        """As read off over a minute: noise averages out, the calibration error does not."""
        return {"sound_level": self.p.room_level + self.p.calibration_error}

    def exact(self) -> Mapping[str, np.ndarray]:
        """The equivalent level, dB(A), without the meter's time weighting, calibration error and noise."""
        self._work()
        before, exposure = self._told
        now = self.energy["steps"] + self.energy["drives"] + self.energy["room"]
        self._told = (self.seconds, now)
        if self.seconds == before:
            return {"sound_level": np.full(len(now), self.p.room_level)}
        return {"sound_level": acoustics.decibels((now - exposure) / (self.seconds - before))}

    def exact_idle(self) -> Mapping[str, float]:
        """Without the calibration error."""
        return {"sound_level": self.p.room_level}

    def describe(self) -> Mapping[str, Any]:
        return self.p.model_dump(mode="json")

    def truth(self) -> Mapping[str, np.ndarray]:
        """The fast level as it is, dB(A), without the meter's own errors."""
        self._work()
        return {"sound_level": acoustics.decibels(self._shown)}

    def strike(self, speed: np.ndarray, mass: np.ndarray, stretch: np.ndarray | float = 1.0) -> np.ndarray:
        """(W_k A_k)^2 of each mode, Pa^2 (S, K), for strikes of speed m/s (S,) and mass kg (S,).

        stretch: factor on the contact time. A_k = G_k |F(f_k)| / r.
        """
        seconds = stretch * acoustics.contact_seconds(speed, mass, self._stiffness)
        impulse = (1 + self.p.restitution) * mass * speed
        spectrum = acoustics.pulse_spectrum(self._frequency, impulse[:, None], np.asarray(seconds)[:, None])
        return np.square(self._gain * spectrum)

    # ------------------------------------------------------------------------------------------ inside

    def _work(self) -> None:
        """Work through the steps collected so far: one frame."""
        count, self._count = self._count, 0
        if count == 0:
            return
        dt = self._dt
        seconds = count * dt
        fading = np.exp(-seconds / acoustics.FAST_SECONDS)
        shown = fading * self._shown + (1 - fading) * self._room

        whine = self._whine(count)  # (N, W)
        keep = np.exp(-dt / acoustics.FAST_SECONDS)
        shown += ((1 - keep) * keep ** np.arange(count - 1, -1, -1)) @ whine

        shown += (self._ringing * acoustics.fast_ringing(self._decay, seconds)).sum(axis=1)
        exposure = acoustics.ringing_energy(self._ringing, self._decay, 0.0, seconds).sum(axis=1)
        ringing = self._ringing * np.exp(-2 * self._decay * seconds)
        robots, left, added = self._landings(count)
        if len(robots):
            decay = self._decay * np.ones((len(robots), 1))
            np.add.at(shown, robots, (added * acoustics.fast_ringing(decay, left)).sum(axis=1))
            np.add.at(exposure, robots, acoustics.ringing_energy(added, decay, 0.0, left).sum(axis=1))
            np.add.at(ringing, robots, added * np.exp(-2 * decay * left))
            np.add.at(self.steps, robots, 1)
        self._ringing, self._shown = ringing, shown
        self.energy["steps"] += exposure
        self.energy["drives"] += whine.sum(axis=0) * dt
        self.energy["room"] += self._room * seconds
        self.seconds += seconds

    def _whine(self, count: int) -> np.ndarray:
        """Squared pressure of the drives in each step, Pa^2 (N, W)."""
        p, torque, velocity = self.p, self._torque[:count], self._velocity[:count]
        at_1_m = acoustics.drive_whine(
            velocity, torque, p.drive_level, p.drive_speed, p.drive_exponent, p.drive_load, self._torque_limit
        )
        return at_1_m / p.distance**2

    def _landings(self, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Strikes of this frame, S of them: robot (S,), seconds left of the frame (S, 1), squared amplitudes (S, K).

        Random numbers are drawn for every foot, whether it lands or not: a robot's do not depend on its neighbours'.
        """
        p = self.p
        touching, speed = self._force[:count] > p.contact_newtons, self._speed[:count]  # (N, W, F)
        before = touching[0] if self._touching is None else self._touching
        self._touching = touching[-1]
        landed = touching & ~np.concatenate((before[None], touching[:-1])) & (speed > p.least_speed)
        drawn = self._rng.standard_normal((*before.shape, 2))
        when, robots, feet = np.nonzero(landed)
        level, stretch = drawn[robots, feet].T
        at = (when, robots, feet)
        added = self.strike(speed[at], self._mass[at], np.exp(p.contact_scatter * stretch))
        added *= 10 ** (p.step_scatter * level / 10)[:, None]
        return robots, ((count - when) * self._dt)[:, None], added
