"""The heading is kept where straight walking is asked for, with the yaw rates that training kept it with."""

from __future__ import annotations

import math

import numpy as np

from hts_go1_runtime.link import State
from hts_go1_runtime.policy import Policy
from hts_go1_runtime.trained import ranges_of, turns

GAIN, LARGEST_YAW_RATE = 0.5, 1.0  # rad/s per rad, rad/s: as the policies were trained


class Heading:
    """That of the first step of a walk, by the robot's IMU."""

    def __init__(self) -> None:
        self._wanted: float | None = None

    def begin(self) -> None:
        """Another walk."""
        self._wanted = None

    def steered(self, policy: Policy, asked: np.ndarray, state: State) -> np.ndarray:
        """The command vx m/s, vy m/s, yaw rate rad/s (3,), with the yaw rate that keeps the heading."""
        if asked[2] != 0 or not asked[:2].any():
            self._wanted = None
            return asked
        if self._wanted is None:
            self._wanted = state.heading
        error = (self._wanted - state.heading + math.pi) % (2 * math.pi) - math.pi
        low, high = turns(ranges_of(policy), LARGEST_YAW_RATE)
        return np.array([asked[0], asked[1], min(max(GAIN * error, low), high)])
