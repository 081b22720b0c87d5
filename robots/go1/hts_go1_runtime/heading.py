"""The heading is kept where straight walking is asked for, with the yaw rates that training kept it with."""

from __future__ import annotations

import math

import numpy as np

from hts_go1_runtime.link import State
from hts_go1_runtime.policy import Policy
from hts_go1_runtime.trained import ranges_of, turns

GAIN, LARGEST_YAW_RATE = 0.5, 1.0  # rad/s per rad, rad/s: as the policies were trained
STRAIGHT = 0
"""Phase of a step that counts; the others are of `lane`."""


class Heading:
    """That of the first step of a walk, by the robot's IMU: all that is steered by where there is room."""

    phase = STRAIGHT

    def __init__(self) -> None:
        self._wanted: float | None = None
        self._nudged = 0.0

    def begin(self) -> None:
        """Another walk."""
        self._wanted = None

    def nudge(self, angle: float) -> None:
        """The operator wants it to walk on so much further to the left, rad. From any thread."""
        self._nudged += angle

    def counts(self, asked: np.ndarray) -> bool:
        """Whether the step that comes next is what a row asks for: it always is."""
        return True

    def see(self, state: State, sent: np.ndarray) -> None:
        """The state of a step and the command (3,) that was sent in it."""

    def steered(self, policy: Policy, asked: np.ndarray, state: State) -> np.ndarray:
        """The command vx m/s, vy m/s, yaw rate rad/s (3,), with the yaw rate that keeps the heading."""
        nudge, self._nudged = self._nudged, 0.0
        if asked[2] != 0 or not asked[:2].any():
            self._wanted = None
            return asked
        if self._wanted is None:
            self._wanted = state.heading
        self._wanted += nudge
        return np.array([asked[0], asked[1], keeping(policy, wrapped(self._wanted - state.heading))])


def keeping(policy: Policy, error: float) -> float:
    """The yaw rate that turns a policy by `error`, rad, to the left, rad/s: within what it was trained with."""
    low, high = turns(ranges_of(policy), LARGEST_YAW_RATE)
    return min(max(GAIN * error, low), high)


def wrapped(angle: float) -> float:
    """The same direction, from -pi to pi, rad."""
    return (angle + math.pi) % (2 * math.pi) - math.pi
