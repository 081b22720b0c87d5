"""The outer loop that finds the command at which the robot walks the asked speed; the same as the twin's.

u <- clip(u + k (v* - v) dt, limits)        once the change of policy and speed has settled
u* = mean(u) + (v* - mean(v))               over the last part: where the loop was heading when it was cut

A step without a measured speed changes nothing. A sensor that is silent for longer, or repeats one number to the last
digit, ends the visit: the loop would drive the command to a limit. So does one that shows the robot walking against
its command, since the loop then tells it to hurry, and a command that stays at a limit: the robot would walk at it for
the rest of the stretch, and nothing comes of it. No command turns round: who is asked to walk forward is never told to
walk backwards, whatever the limits allow and the sensor shows.
"""

from __future__ import annotations

import math

from hts_go1_runtime.errors import RuntimeFault

GAIN = 1.0  # k, 1/s
SETTLING = 2.0  # s, at most a quarter of the stretch
FINDING = 2.5  # s after settling until the loop has found its level
AGAINST, AGAINST_SECONDS = 0.1, 1.0  # m/s, s at a time: one that sways about 0 is no robot that walks backwards
AT_LIMIT_SECONDS = 2.5  # s at a time: the loop's time constant is 1 / k, so more is no overshoot
BLIND = 0.5  # s without a new measured speed (a camera gives ten a second): what is turned after that is turned blindly


class Trimming:
    """asked: speed, m/s; limits: of the command, m/s; seconds: of the stretch; period: of control, s; vouched: whether
    a person says that a command at its limit is an answer."""

    def __init__(
        self, asked: float, limits: tuple[float, float], seconds: float, period: float, vouched: bool = False
    ) -> None:
        low, high = limits
        self._low, self._high = (max(low, 0.0), high) if asked > 0 else (low, min(high, 0.0)) if asked < 0 else limits
        self._asked, self._period, self._vouched = asked, period, vouched
        self.command = min(max(asked, self._low), self._high)
        self._settling = min(SETTLING, seconds / 4)
        self._begin = min(self._settling + FINDING, seconds / 2)
        self._elapsed, self._sent, self._walked, self._count = 0.0, 0.0, 0.0, 0
        self._blind, self._last = 0.0, math.nan
        self._against, self._at_limit, self._there = 0.0, 0.0, 0.0

    def see(self, speed: float) -> None:
        """The measured speed forward of a step, m/s, NaN where the sensor missed it: changes `command`.

        Raises RuntimeFault if nothing new was measured for longer than BLIND, if it was the other way for
        AGAINST_SECONDS, or if the command has stayed at a limit for AT_LIMIT_SECONDS and nobody vouches for that.
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
        self._check_direction(speed)
        if self._elapsed >= self._begin:
            self._sent, self._walked, self._count = self._sent + self.command, self._walked + speed, self._count + 1
        if self._elapsed >= self._settling:
            moved = self.command + GAIN * self._period * (self._asked - speed)
            self.command = min(max(moved, self._low), self._high)
            self._check_limit(speed)
        self._elapsed += self._period

    def _check_direction(self, speed: float) -> None:
        forward = math.copysign(speed, speed * self._asked)
        self._against = self._against + self._period if forward < -AGAINST else 0.0
        if self._against >= AGAINST_SECONDS:
            raise RuntimeFault(
                f"The sensor of the trunk's speed has shown {speed:.2f} m/s, the other way, for {AGAINST_SECONDS:g} s "
                f"in which the robot was told {self.command:.2f} m/s: it counts the other way, or its axes are "
                "turned. Correct it (x forward in the trunk's frame), then run the same again."
            )

    def _check_limit(self, speed: float) -> None:
        if self._low < self.command < self._high or self._vouched:
            self._at_limit = self._there = 0.0
            return
        self._at_limit, self._there = self._at_limit + self._period, self._there + speed * self._period
        if self._at_limit >= AT_LIMIT_SECONDS:
            raise RuntimeFault(self._refused(self.command, f"the sensor showed {self._there / self._at_limit:.2f} m/s"))

    def found(self) -> tuple[float, bool]:
        """The command to freeze, m/s, and whether a limit held it back."""
        command = self.command
        if self._count:
            command = (self._sent + self._asked * self._count - self._walked) / self._count
        held = min(max(command, self._low), self._high)
        return held, command <= self._low or command >= self._high

    def check(self) -> None:
        """Raise RuntimeFault where a limit held the command back, unless a person vouches that it is an answer: `hts`
        refuses what is recorded at it."""
        command, at_limit = self.found()
        if at_limit and not self._vouched:
            shown = f"the sensor showed {self._walked / self._count:.2f} m/s" if self._count else "nothing was measured"
            raise RuntimeFault(self._refused(command, shown))

    def _refused(self, command: float, shown: str) -> str:
        return (
            f"Trimmed for {self._asked:g} m/s the command ended at {command:g} m/s, an end of what is allowed "
            f"({self._low:g} to {self._high:g}), and {shown}: `hts` refuses this speed. See that the sensor is right "
            "(m/s, x forward in the trunk's frame) and run the same again; if the robot does walk so, it is an answer: "
            "record it with --at-limit."
        )
