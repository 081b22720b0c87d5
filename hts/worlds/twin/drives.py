"""What a reality's drives do beside the default twin's: motors that differ, saturate, stick, and have play.

    tau_m = k_i tau_i [1 - s (tau_i / tau_max)^2]      tau_i: what the current would make with the common constant
    extra dry friction = tau_c r exp(-(q' / v_s)^2)    Stribeck
    p'    = [b/2 clip(tau_m / tau_0, +-1) - p] / T     play: the motor stands on the side to which it pushes

The play is quasi-static: it crosses in T, and nothing is lost on the way. The encoder sits on the motor's side, so
position control pulls at q + p, and a joint gives way by b where its torque changes sign. Arrays are (W, J).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hts.worlds.twin.model import Machine
from hts.worlds.twin.structure import BodyStructure

CROSSING_SECONDS = 0.004  # T; E: a rotor at 100 rad/s crosses half a degree of the joint's angle in about this
CROSSING_TORQUE = 0.3  # tau_0, N m; E: as the dry friction that holds the joint meanwhile


@dataclass(frozen=True)
class Motors:
    """What the motors of a reality make of their currents. constant: k_i (J,); saturation: s / tau_max^2 (J,)."""

    constant: np.ndarray
    saturation: np.ndarray

    @classmethod
    def of(cls, structure: BodyStructure, serial: int, limit: np.ndarray) -> Motors:
        """limit: tau_max (J,), N·m."""
        spread = np.random.default_rng([serial, 3]).uniform(-1, 1, len(limit))
        return cls(1 + structure.torque_constant_spread * spread, structure.torque_saturation / np.square(limit))

    def torque(self, current: np.ndarray) -> np.ndarray:
        """tau_m, N·m, from tau_i, (..., J)."""
        made: np.ndarray = self.constant * current * (1 - self.saturation * np.square(current))
        return made


class Drives:
    """Structures of the joint drives of W robots. motors: k_i and s; play: p, rad (W, J).

    sticks: whether there is static friction; half, rate: b / 2 and dt / T."""

    def __init__(
        self, machine: Machine, structure: BodyStructure, serial: int, limit: np.ndarray, dt: float, num_worlds: int
    ) -> None:
        joints = machine.spec.num_joints
        self.motors = Motors.of(structure, serial, limit)
        self._stiction = machine.friction * structure.stribeck_ratio
        self._speed = max(structure.stribeck_speed, 1e-6)
        self.sticks = structure.stribeck_ratio > 0
        self.half = structure.backlash / 2
        self.rate = min(dt / CROSSING_SECONDS, 1.0)
        self.play = np.zeros((num_worlds, joints))

    def stiction(self, velocity: np.ndarray) -> np.ndarray | float:
        """Dry friction on top of the sliding one at joint speeds, N·m, at least 0."""
        return self._stiction * np.exp(-np.square(velocity / self._speed)) if self.sticks else 0.0

    def cross(self, torque: np.ndarray) -> None:
        """The play of the next step, after a step with this motor torque."""
        if self.half > 0:
            side = np.minimum(np.maximum(torque / CROSSING_TORQUE, -1), 1)
            self.play += self.rate * (self.half * side - self.play)


def makes_a_difference(structure: BodyStructure) -> bool:
    """Whether any of these structures is on."""
    return any((
        structure.torque_constant_spread,
        structure.torque_saturation,
        structure.stribeck_ratio,
        structure.backlash,
    ))  # fmt: skip
