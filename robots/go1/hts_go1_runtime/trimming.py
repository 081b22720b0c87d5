"""The outer loop that finds the command at which the robot walks the asked speed; the same as the twin's.

u <- clip(u + k (v* - v) dt, limits)        once the change of policy and speed has settled
u* = mean(u) + (v* - mean(v))               over the last part: where the loop was heading when it was cut

A step without a measured speed changes nothing; a sensor that is silent for longer ends the visit.
"""

from __future__ import annotations

import math

from hts_go1_runtime.errors import RuntimeFault

GAIN = 1.0  # k, 1/s
SETTLING = 2.0  # s, at most a quarter of the stretch
FINDING = 2.5  # s after settling until the loop has found its level
BLIND = 0.5  # s without a measured speed: a command that is turned on after that is turned blindly


class Trimming:
    """asked: speed, m/s; limits: of the command, m/s; seconds: of the stretch; period: of control, s."""

    def __init__(self, asked: float, limits: tuple[float, float], seconds: float, period: float) -> None:
        self._asked, (self._low, self._high), self._period = asked, limits, period
        self.command = min(max(asked, self._low), self._high)
        self._settling = min(SETTLING, seconds / 4)
        self._begin = min(self._settling + FINDING, seconds / 2)
        self._elapsed, self._sent, self._walked, self._count = 0.0, 0.0, 0.0, 0
        self._blind = 0.0

    def see(self, speed: float) -> None:
        """The measured speed forward of a step, m/s, NaN where the sensor missed it: changes `command`.

        Raises RuntimeFault if nothing was measured for longer than BLIND.
        """
        if not math.isfinite(speed):
            self._elapsed, self._blind = self._elapsed + self._period, self._blind + self._period
            if self._blind > BLIND:
                raise RuntimeFault(
                    f"The sensor of the trunk's speed has given nothing for {BLIND:g} s while a command was trimmed. "
                    "See that it sees the robot all along the track, then run the same again."
                )
            return
        self._blind = 0.0
        if self._elapsed >= self._begin:
            self._sent, self._walked, self._count = self._sent + self.command, self._walked + speed, self._count + 1
        if self._elapsed >= self._settling:
            moved = self.command + GAIN * self._period * (self._asked - speed)
            self.command = min(max(moved, self._low), self._high)
        self._elapsed += self._period

    def found(self) -> tuple[float, bool]:
        """The command to freeze, m/s, and whether a limit held it back."""
        command = self.command
        if self._count:
            command = (self._sent + self._asked * self._count - self._walked) / self._count
        held = min(max(command, self._low), self._high)
        return held, command <= self._low or command >= self._high
