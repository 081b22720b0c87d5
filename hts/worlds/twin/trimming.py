"""The outer loop that finds the command at which a robot walks the asked speed.

    u <- clip(u + k (v* - v) dt, limits)        while trimming, once the change of policy and speed has settled
    u* = mean(u) + (v* - mean(v))               over the last part: where the loop was heading when it was cut

v is the speed forward that the robot's sensors give. A walking policy's speed follows its command with a slope near 1,
so the last line is one Newton step for what the loop has left; with v = u + noise it is exact but for the noise's mean.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hts.contracts import HoldSpeed

GAIN = 1.0  # k, 1/s: slower than a stride and than the policy's own answer to a command (about half a second)
SETTLING = 2.0  # s, at most a quarter of the stretch
FINDING = 2.5  # s after settling until the loop has found its level: the command is taken from what follows


@dataclass(frozen=True)
class HeldCommand:
    """What trimming found of one robot: the command to freeze, m/s, whether a limit held it back, and its falls."""

    command: float
    saturated: bool
    falls: int = 0


class Trimming:
    """One trimming stretch of W robots. asked: speeds (W,), m/s; period: of control, s."""

    def __init__(self, asked: np.ndarray, hold: HoldSpeed, period: float) -> None:
        self._asked, self._period = asked, period
        ranges = np.array([hold.within(speed) for speed in asked.ravel()]).reshape(*asked.shape, 2)
        self._low, self._high = ranges[..., 0], ranges[..., 1]
        self.command = np.clip(asked, self._low, self._high)  # (W,), what to send now
        self._settling = min(SETTLING, hold.seconds / 4)
        self._begin = min(self._settling + FINDING, hold.seconds / 2)
        self._unsteady = np.full(asked.shape, self._settling)  # s until a robot's speed may be believed again
        self._elapsed = 0.0
        self._sums = np.zeros((3, *asked.shape))  # of commands, of speeds, and how many, over the last part
        self._falls = np.zeros(asked.shape, dtype=int)

    def see(self, speed: np.ndarray) -> None:
        """The measured speed forward of a control step, (W,): changes `command`."""
        steady = self._unsteady <= 0
        if self._elapsed >= self._begin:
            self._sums += np.where(steady, np.stack([self.command, speed, np.ones_like(speed)]), 0.0)
        step = GAIN * self._period * (self._asked - speed)
        self.command = np.where(steady, np.clip(self.command + step, self._low, self._high), self.command)
        self._unsteady -= self._period
        self._elapsed += self._period

    def fell(self, mask: np.ndarray) -> None:
        """The robots of the mask (W,) were stood up again: their speed means nothing for a while."""
        self._falls[mask] += 1
        self._unsteady[mask] = self._settling

    def found(self) -> list[HeldCommand]:
        """The command to freeze of each robot; the one at the end for a robot that was never steady."""
        sent, walked, count = self._sums
        some = np.maximum(count, 1)
        command = np.where(count > 0, (sent + self._asked * count - walked) / some, self.command)
        held = np.clip(command, self._low, self._high)
        saturated = (command <= self._low) | (command >= self._high)
        return [
            HeldCommand(float(one), bool(at_limit), int(falls))
            for one, at_limit, falls in zip(held, saturated, self._falls, strict=True)
        ]
