"""When the robot has to be stopped, from its states and its silence."""

from __future__ import annotations

import math

import numpy as np

from hts_go1_runtime.following import Following
from hts_go1_runtime.frozen import Frozen
from hts_go1_runtime.link import Command, State
from hts_go1_runtime.machine import JOINTS, POSITION_HIGH, POSITION_LOW, VELOCITY_LIMIT, Limits, first_of

REASONS = (
    "tilt", "joint limit", "joint speed", "over-current", "low voltage", "temperature", "lost link", "late loop",
    "operator", "not finite", "orientation", "not following", "frozen sensor",
)  # fmt: skip
UNIT = 0.05  # of an IMU's quaternion from length 1: float32 and its firmware's rounding stay below a thousandth
DRIFT = 2e-4  # of two clocks, s/s: quartz is ten times better

Fault = tuple[str, str]
"""Reason and numbers."""


class Guard:
    """Looks at every state that arrives."""

    def __init__(self, limits: Limits) -> None:
        self.limits = limits
        self._low, self._high = POSITION_LOW - limits.position_margin, POSITION_HIGH + limits.position_margin
        self._speed = limits.velocity_share * np.minimum(VELOCITY_LIMIT, limits.velocity)
        self._upright = -math.cos(limits.tilt)
        self._offset, self._at = math.inf, 0.0  # smallest difference of the two clocks, and when it was seen
        self._seen = -1
        self._stamp, self._ticked = math.nan, 0.0  # the newest stamp, and when it was new
        self._following = Following(limits.least_torque_share)
        self._frozen = Frozen(limits.frozen)

    def sent(self, command: Command, now: float) -> None:
        """A command has left: the joints are to follow it."""
        self._following.sent(command, now)
        self._frozen.sent(command)

    def state(self, state: State) -> Fault | None:
        """What is wrong with a state, or None. A number that is not measured (NaN) of the pack, of the feet or of the
        speed is not looked at; one of the joints, the trunk or the clock (no state would ever be late) is a fault."""
        limits, gravity = self.limits, state.gravity  # upright, if the quaternion were all zeros
        moving = (state.q, state.dq, state.tau, state.quaternion, state.gyro, state.stamp)
        if not all(np.isfinite(values).all() for values in moving):
            return "not finite", "the state of the joints or the trunk, or its time stamp, holds what is no number"
        length = float(np.linalg.norm(state.quaternion))
        if abs(length - 1) > UNIT:
            shown = ", ".join(f"{part:.2f}" for part in state.quaternion)
            return "orientation", (
                f"the IMU's quaternion ({shown}) has length {length:.2f}, a rotation's is 1 within {UNIT:g}: the IMU "
                "is not being read. Restart the robot, or its own process that reads the IMU"
            )
        if gravity[2] > self._upright:
            tilt = math.degrees(math.acos(min(1.0, max(-1.0, -gravity[2]))))
            return "tilt", f"{tilt:.0f} degrees, at most {math.degrees(limits.tilt):.0f}"
        if (joint := first_of((state.q < self._low) | (state.q > self._high))) is not None:
            return "joint limit", (
                f"{JOINTS[joint]} at {state.q[joint]:.3f} rad, its range is {POSITION_LOW[joint]:.3f} to "
                f"{POSITION_HIGH[joint]:.3f}"
            )
        if (joint := first_of(np.abs(state.dq) > self._speed)) is not None:
            return "joint speed", f"{JOINTS[joint]} at {state.dq[joint]:.1f} rad/s, at most {self._speed[joint]:.1f}"
        if abs(state.current) > limits.current:  # of either sign: a link may count the other way
            return "over-current", f"{state.current:.1f} A drawn from the pack, at most {limits.current:g}"
        if state.voltage < limits.voltage:
            return "low voltage", f"{state.voltage:.2f} V at the pack, at least {limits.voltage:g}"
        if (joint := first_of(state.temperature > limits.temperature)) is not None:
            return (
                "temperature",
                f"{JOINTS[joint]} at {state.temperature[joint]:.0f} degC, at most {limits.temperature:g}",
            )
        stands_still = self._frozen.state(state)
        if stands_still:
            return "frozen sensor", stands_still
        astray = self._following.state(state)
        return ("not following", astray) if astray else None

    def silence(self, newest: State, now: float) -> Fault | None:
        """Whether the robot has been silent for too long, or the newest state took too long. (Older ones that came with
        it may have waited for this process.)"""
        age = now - newest.received
        if age > self.limits.silence:
            return "lost link", f"nothing heard for {1e3 * age:.0f} ms, at most {1e3 * self.limits.silence:.0f}"
        return self._stale(newest)

    def _stale(self, state: State) -> Fault | None:
        """How much later than the quickest this state arrived; the two clocks need not agree, only run alike."""
        if state.sequence == self._seen:
            return None
        self._seen = state.sequence
        if state.stamp != self._stamp:
            self._stamp, self._ticked = state.stamp, state.received
        difference = state.received - state.stamp
        self._offset = min(self._offset + DRIFT * max(state.received - self._at, 0.0), difference)
        self._at = state.received
        late = difference - self._offset
        if late > self.limits.stale:
            stands = (
                f": their stamp stands at {state.stamp:g} s"
                if state.received - self._ticked > self.limits.stale
                else ""
            )
            return "lost link", f"states arrive {1e3 * late:.0f} ms late, at most {1e3 * self.limits.stale:.0f}{stands}"
        return None
