"""What the robot's own sensors show of W robots at the control rate, and what a camera beside the track sees."""

from __future__ import annotations

import itertools

import numpy as np

from hts.worlds.twin.dynamics import Dynamics
from hts.worlds.twin.parameters import SensorParameters


def in_words(values: np.ndarray, step: float) -> np.ndarray:
    """Rounded to whole steps of a digital word; step 0 leaves the values alone."""
    return np.rint(values / step) * step if step > 0 else values


class Sensors:
    """Noise, quantisation and fixed errors. Noise is drawn from `rng`; what is fixed per machine from `machine`."""

    def __init__(
        self, parameters: SensorParameters, dynamics: Dynamics, machine: int, rng: np.random.Generator
    ) -> None:
        self.p, self._dynamics, self._rng = parameters, dynamics, rng
        fixed = np.random.default_rng([machine, 2])
        roll, pitch = parameters.tilt_error * fixed.uniform(-1, 1, 2)
        self._tilt = np.array([[1, 0, pitch], [0, 1, -roll], [-pitch, roll, 1]])  # small rotation
        num_feet = dynamics.foot_force.shape[1]
        self._gain = 1 + parameters.foot_force_gain * fixed.uniform(-1, 1, num_feet)
        self._drift = np.zeros((dynamics.num_worlds, num_feet))
        joints = dynamics.machine.spec.num_joints
        p = parameters
        sizes = [3, num_feet, 3, 3, num_feet, joints, joints, joints]  # noise of the channels in `read`
        self._cuts = [slice(int(a), int(b)) for a, b in itertools.pairwise(np.cumsum([0, *sizes]))]
        sigma = [p.gravity_noise, p.foot_force_drift, p.camera_speed_noise, p.gyro_noise, p.foot_force_noise]
        self._sigma = np.repeat([*sigma, p.position_noise, p.velocity_noise, p.torque_noise], sizes)
        self._period = 1.0  # s: that the drift's sigma is for

    def read(self, period: float) -> dict[str, np.ndarray]:
        """Sim channels now, name -> (W, ...), without targets and commands. period: s since the last reading."""
        p, body = self.p, self._dynamics
        if period != self._period:
            self._sigma[self._cuts[1]], self._period = p.foot_force_drift * np.sqrt(period), period
        drawn = self._rng.standard_normal((body.num_worlds, self._sigma.size))
        drawn *= self._sigma
        tilted, drifted, moved, turned, pressed, placed, swung, loaded = [drawn[:, cut] for cut in self._cuts]
        rotation = body.rotation()
        down = -rotation[:, :, 2] if body.down is None else np.matmul(rotation, body.down[:, :, None])[:, :, 0]
        gravity = down @ self._tilt.T + tilted
        velocity = np.matmul(rotation, body.qvel[:, :3, None])[:, :, 0]
        self._drift += drifted
        return {
            "projected_gravity": gravity / np.sqrt(np.add.reduce(gravity * gravity, axis=1, keepdims=True)),
            "base_velocity": velocity * (1 + p.camera_scale_error) + moved,
            "angular_velocity": body.qvel[:, 3:6] + turned,
            "foot_force": body.foot_force * self._gain + self._drift + pressed,
            "joint_position": body.joint_position() + placed,
            "joint_velocity": in_words(body.joint_velocity() + swung, p.velocity_word),
            # From motor current: what the firmware believes, without gear friction and torque-constant error.
            "joint_torque": in_words(body.commanded_torque + loaded, p.torque_word),
        }
