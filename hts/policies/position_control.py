"""Position control in a log: which gains, and which lag of the targets, explain the torques."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

FEWEST = 50  # rows
LONGEST_LAG = 40  # rows
UNEXPLAINED = 0.05
"""Share of a joint's torque (root mean square) that position control may leave in a log that is worth looking at."""
KP_ALIKE, KD_ALIKE = 0.05, 0.15
"""The best gains may differ so much from the stated ones, relative: state and torque are read a moment apart."""
ALIKE, EXACT = 3.0, 0.003  # or the stated ones may leave so many times as much as the best, or this share
REFUTED = 0.03  # stated gains that leave more, where others leave a third, are wrong; less may be that moment
SEEN = 0.2  # a gain is shown if a change by so much would be seen
AT_LIMIT = 0.98  # of the torque limit: such a torque says nothing of gains


@dataclass(frozen=True)
class Fit:
    """The gains that explain the torques best for one lag, rows. kp, kd (J,); left (J,): share that they leave."""

    lag: int
    kp: np.ndarray
    kd: np.ndarray
    left: np.ndarray


class PositionControl:
    """tau_k = kp (u_{k-lag} - q_k) - kd dq_k of J joints. All arrays (n, J); limit (J,) N·m."""

    def __init__(
        self,
        names: Sequence[str],
        target: np.ndarray,
        position: np.ndarray,
        velocity: np.ndarray,
        torque: np.ndarray,
        limit: np.ndarray,
    ) -> None:
        self.names, self.target = names, target
        self.position, self.velocity, self.torque = (one[LONGEST_LAG:] for one in (position, velocity, torque))
        self.free = np.abs(self.torque) < AT_LIMIT * limit

    def _parts(self, joint: int, lag: int) -> tuple[np.ndarray, np.ndarray]:
        """What kp and kd are multiplied by (m, 2), and the torques (m,)."""
        sent = self.target[LONGEST_LAG - lag : len(self.target) - lag, joint]
        parts = np.stack([sent - self.position[:, joint], -self.velocity[:, joint]], 1)
        return parts[self.free[:, joint]], self.torque[self.free[:, joint], joint]

    def fit(self, lag: int) -> Fit:
        """By least squares; a joint with hardly a torque leaves all."""
        count = len(self.names)
        kp, kd, left = np.zeros(count), np.zeros(count), np.ones(count)
        for joint in range(count):
            parts, torque = self._parts(joint, lag)
            if len(torque) < FEWEST or np.std(torque) < 1e-9:
                continue
            (kp[joint], kd[joint]), *_ = np.linalg.lstsq(parts, torque, rcond=None)
            left[joint] = _left(parts, torque, kp[joint], kd[joint])
        return Fit(lag, kp, kd, left)

    def left_by(self, kp: np.ndarray, kd: np.ndarray, lag: int) -> np.ndarray:
        """(J,) share of the torque that these gains leave."""
        joints = range(len(self.names))
        return np.array([_left(*self._parts(joint, lag), kp[joint], kd[joint]) for joint in joints])

    def alike(self, kp: np.ndarray, kd: np.ndarray, fit: Fit) -> np.ndarray:
        """(J,) bool: the stated gains are the best ones, or explain the torques as well."""
        near = (np.abs(fit.kp - kp) <= KP_ALIKE * np.abs(kp)) & (np.abs(fit.kd - kd) <= KD_ALIKE * np.abs(kd))
        return near | (self.left_by(kp, kd, fit.lag) <= np.maximum(ALIKE * fit.left, EXACT))

    def unseen(self, kp: np.ndarray, kd: np.ndarray, lag: int, left: np.ndarray) -> str:
        """In words, a gain of which the log shows nothing: another one would explain it as well; empty if none."""
        for joint, name in enumerate(self.names):
            parts, torque = self._parts(joint, lag)
            # a change by SEEN against what is left, of which neighbouring rows tell the same
            noise = 3.0 * left[joint] * np.sqrt(np.mean(np.square(torque)) * 10.0 / len(torque))
            for what, gain, part in (("kp", kp[joint], parts[:, 0]), ("kd", kd[joint], parts[:, 1])):
                if gain and SEEN * abs(gain) * np.std(part) < noise:
                    return f"{what} of {name}"
        return ""


def _left(parts: np.ndarray, torque: np.ndarray, kp: float, kd: float) -> float:
    rest = torque - parts @ np.array([kp, kd])
    return float(np.sqrt(np.mean(np.square(rest)) / max(np.mean(np.square(torque)), 1e-18)))
