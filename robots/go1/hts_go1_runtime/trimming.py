"""The outer loop that finds the command at which the robot walks the asked speed; the same as the twin's.

u <- clip(u + k (v* - v) dt, limits)        once the change of policy and speed has settled
u* = mean(u) + (v* - mean(v))               over the last part: where the loop was heading when it was cut

A step without a measured speed changes nothing. A sensor that is silent for longer, or repeats one number to the last
digit, ends the visit: the loop would drive the command to a limit.
"""

from __future__ import annotations

import math

from hts_go1_runtime.errors import RuntimeFault

GAIN = 1.0  # k, 1/s
SETTLING = 2.0  # s, at most a quarter of the stretch
FINDING = 2.5  # s after settling until the loop has found its level
BLIND = 0.5  # s without a new measured speed (a camera gives ten a second): what is turned after that is turned blindly


class Trimming:
    """asked: speed, m/s; limits: of the command, m/s; seconds: of the stretch; period: of control, s."""

    def __init__(self, asked: float, limits: tuple[float, float], seconds: float, period: float) -> None:
        self._asked, (self._low, self._high), self._period = asked, limits, period
        self.command = min(max(asked, self._low), self._high)
        self._settling = min(SETTLING, seconds / 4)
        self._begin = min(self._settling + FINDING, seconds / 2)
        self._elapsed, self._sent, self._walked, self._count = 0.0, 0.0, 0.0, 0
        self._blind, self._last = 0.0, math.nan

    def see(self, speed: float) -> None:
        """The measured speed forward of a step, m/s, NaN where the sensor missed it: changes `command`.

        Raises RuntimeFault if nothing new was measured for longer than BLIND.
        """
        measured = math.isfinite(speed)
        self._blind = 0.0 if measured and speed != self._last else self._blind + self._period
        if self._blind > BLIND:
            given = f"nothing but {speed:g} m/s" if measured else "nothing"
            raise RuntimeFault(
                f"The sensor of the trunk's speed has given {given} for {BLIND:g} s while a command was trimmed. "
                "See that it sees the robot all along the track, then run the same again."
            )
        if not measured:
            self._elapsed += self._period
            return
        self._last = speed
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

    def check(self, vouched: bool) -> None:
        """Raise RuntimeFault where a limit held the command back, unless a person vouches that it is an answer: `hts`
        refuses what is recorded at it."""
        command, at_limit = self.found()
        if at_limit and not vouched:
            shown = f"the sensor showed {self._walked / self._count:.2f} m/s" if self._count else "nothing was measured"
            raise RuntimeFault(
                f"Trimmed for {self._asked:g} m/s the command ended at {command:g} m/s, an end of what is allowed "
                f"({self._low:g} to {self._high:g}), and {shown}: `hts` refuses this speed. See that the sensor is "
                "right and run the same again; if the robot does walk so, it is an answer: record it with --at-limit."
            )
