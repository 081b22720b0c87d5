"""What the robot's own sensors show of W robots at the control rate, and what a camera beside the track sees."""

from __future__ import annotations

import numpy as np

from hts.worlds.twin.dynamics import Dynamics
from hts.worlds.twin.parameters import SensorParameters


def in_words(values: np.ndarray, step: float) -> np.ndarray:
    """Rounded to whole steps of a digital word; step 0 leaves the values alone."""
    return np.round(values / step) * step if step > 0 else values


class Sensors:
    """Noise, quantisation and fixed errors. Noise is drawn from `rng`; what is fixed per machine from `machine`."""

    def __init__(self, parameters: SensorParameters, dynamics: Dynamics, machine: int, rng: np.random.Generator) -> None:
        self.p, self._dynamics, self._rng = parameters, dynamics, rng
        fixed = np.random.default_rng([machine, 2])
        roll, pitch = parameters.tilt_error * fixed.uniform(-1, 1, 2)
        self._tilt = np.array([[1, 0, pitch], [0, 1, -roll], [-pitch, roll, 1]])  # small rotation
        num_feet = dynamics.foot_force.shape[1]
        self._gain = 1 + parameters.foot_force_gain * fixed.uniform(-1, 1, num_feet)
        self._drift = np.zeros((dynamics.num_worlds, num_feet))

    def read(self, period: float) -> dict[str, np.ndarray]:
        """Sim channels now, name -> (W, ...), without targets and commands. period: s since the last reading."""
        p, body = self.p, self._dynamics
        self._drift += p.foot_force_drift * np.sqrt(period) * self._rng.standard_normal(self._drift.shape)
        down = np.broadcast_to([0.0, 0.0, -1.0], (body.num_worlds, 3))
        gravity = body.to_trunk(down) @ self._tilt.T + self._noise(p.gravity_noise, 3)
        joints = body.commanded_torque.shape[1]
        return {
            "joint_position": body.joint_position() + self._noise(p.position_noise, joints),
            "joint_velocity": in_words(body.joint_velocity() + self._noise(p.velocity_noise, joints), p.velocity_word),
            # From motor current: what the firmware believes, without gear friction and torque-constant error.
            "joint_torque": in_words(body.commanded_torque + self._noise(p.torque_noise, joints), p.torque_word),
            "angular_velocity": body.qvel[:, 3:6] + self._noise(p.gyro_noise, 3),
            "projected_gravity": gravity / np.linalg.norm(gravity, axis=1, keepdims=True),
            "base_velocity": body.to_trunk(body.qvel[:, :3]) * (1 + p.camera_scale_error) + self._noise(p.camera_speed_noise, 3),
            "foot_force": body.foot_force * self._gain + self._drift + self._noise(p.foot_force_noise, self._drift.shape[1]),
        }

    def _noise(self, sigma: float, size: int) -> np.ndarray:
        return sigma * self._rng.standard_normal((self._dynamics.num_worlds, size))
