"""Whether a sensor still measures: one that froze repeats its last number for ever, and looks well to every limit.

A channel is frozen where it has given one value, to the last digit, for `SEEN` s although it should have changed:

    joint_position      of a joint, while its own target moved by MOVED
    joint_velocity      of a joint, while its position moved by MOVED from where that speed would have taken it
    angular_velocity, projected_gravity     all numbers of it at once, while the target of any joint moved by MOVED

so a robot that lies or stands still, or whose motors idle, is never stopped by it, nor one whose speeds come in coarse
words. Nothing else of a state is looked at: feet, charge, voltage and temperatures may stay as they are for long, a
torque at its limit does, and the trunk's speed is another sensor's (below, and `trimming`). A clock that stands still
is noticed as states that come ever later.

Where SEEN comes from: logs of a Go2 that walks, under its own controller, with a leg held back by a wire, and under a
learned policy (29 s, 400 to 500 rows a second): a joint's position gave one value for 32 ms at most, its speed for 14,
gyroscope and attitude for 5. A trunk tips over in about sqrt(0.3 m / 9.81 m/s2) = 0.17 s.

Simulated robots (default twin and 16 realities, 22 s each at 0 to 1.3 m/s) came to 32 ms of a speed, 4 of a position.

What only the robot gives, the current of its pack, is slower: of a Go2 that stood still it gave one value for 0.88 s at
most, of the simulated ones for 0.96, and for 1.24 with the slowest and coarsest gauge that is drawn. A row in which it
repeats itself for `REAL` s tells little, so it ends the visit sitting (`Repeats`). So does the trunk's speed in a row
of a comparison, by which the row's seconds count: a tracker that has lost the robot repeats where it was last. So does
a channel that was measured at first and holds no numbers for as long (`Missing`): no reader takes such a row, and no
limit is seen in it.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable

import numpy as np

from hts_go1_runtime.errors import RuntimeFault
from hts_go1_runtime.link import Command, J, State
from hts_go1_runtime.log import holds
from hts_go1_runtime.machine import JOINTS, Limits

SEEN, REAL = Limits.frozen, 3.0  # s, where a bundle says nothing
MOVED = 0.05  # rad: 1.5 N*m and more at the gains of common policies
CLOSE = 1e-9  # s
CHANNELS = (
    *(f"joint_position of {joint}" for joint in JOINTS),
    *(f"joint_velocity of {joint}" for joint in JOINTS),
    "angular_velocity",
    "projected_gravity",
)
OVER, MOVING = 1.0, 0.5  # s; rad/s, root mean square of all joints: `hts` asks the same of the rows that it reads
READ_AGAIN = (
    "Start the robot's own process that reads it again, then run the same again; for a monitor that is as slow as that "
    "there is --frozen-real-seconds."
)
SEE_AGAIN = (
    "See that its sensor sees the robot all along the track, then run the same again; for one that is as slow as that "
    "there is --frozen-real-seconds."
)
_TARGETS = np.concatenate([np.eye(J, dtype=bool), np.zeros((J, J), dtype=bool), np.ones((2, J), dtype=bool)])
"""Whose targets should change a channel, (channels, J)."""
_SPEEDS = slice(J, 2 * J)


class Frozen:
    """Looks at every state that arrives. seconds: from which a channel that repeats itself is frozen; 0: none is."""

    def __init__(self, seconds: float) -> None:
        self._seconds = seconds
        self._target: np.ndarray | None = None
        self._before: State | None = None
        self._since = np.zeros(len(CHANNELS))  # when each channel changed last; then:
        self._low, self._high = np.zeros((2, len(CHANNELS), J))  # range of the targets since
        self._position, self._stamp = np.zeros((2, len(CHANNELS), J))  # of the joints, and the robot's clock

    def sent(self, command: Command) -> None:
        """A command has left. One that holds no position moves nothing."""
        self._target = command.q if command.kp.any() else None

    def state(self, state: State) -> str:
        """Which channel is frozen, since when; "" if none is."""
        if not self._seconds:
            return ""
        before, self._before = self._before, state
        if before is None or self._target is None:
            self._begin(np.ones(len(CHANNELS), dtype=bool), state)
            return ""
        self._begin(_changed(before, state), state)
        self._low, self._high = np.minimum(self._low, self._target), np.maximum(self._high, self._target)
        still = state.received - self._since >= self._seconds - CLOSE
        if not still.any():
            return ""
        frozen = np.flatnonzero(still & (self._should_have_changed(state) > MOVED))
        if not frozen.size:
            return ""
        first = int(frozen[self._since[frozen].argmin()])
        others = f" (and {frozen.size - 1} more channels)" if frozen.size > 1 else ""
        blocked = ", or the joint is blocked" if first < J else ""
        return (
            f"{CHANNELS[first]}{others} has been {_shown(state, first)} to the last digit for "
            f"{1e3 * (state.received - self._since[first]):.0f} ms of moving, since time {self._since[first]:.3f}, at "
            f"most {1e3 * self._seconds:.0f} ms: it is not being read{blocked}. Look at the sensor and at the robot's "
            "own process that reads it, or restart the robot"
        )

    def _begin(self, which: np.ndarray, state: State) -> None:
        """These channels (a mask) have changed just now."""
        self._since[which] = state.received
        self._low[which] = self._high[which] = state.q if self._target is None else self._target
        self._position[which], self._stamp[which] = state.q, state.stamp

    def _should_have_changed(self, state: State) -> np.ndarray:
        """By how much each channel's cause has moved since it changed last, rad, (channels,)."""
        moved = np.where(_TARGETS, self._high - self._low, 0.0).max(axis=1)
        position, stamp = (of[_SPEEDS].diagonal() for of in (self._position, self._stamp))
        moved[_SPEEDS] = np.abs(state.q - position - state.dq * (state.stamp - stamp))
        return moved


class Repeats:
    """Looks at what only the robot gives, a reading a step. seconds: after which it must have changed; 0: never.
    remedy: ends the line, what to do; of, so: in what it has stood still, and what of it."""

    def __init__(
        self,
        channel: str,
        seconds: float,
        remedy: str = READ_AGAIN,
        of: str = "a row",
        so: str = "the row would tell nothing",
    ) -> None:
        self._channel, self._seconds, self._remedy, self._of, self._so = channel, seconds, remedy, of, so
        self._last = np.array([math.nan])
        self._since = self._before = self._stood = 0.0

    def see(self, reading: float | np.ndarray, now: float, counts: bool = True) -> None:
        """A step's reading, a number or (n,) of them, which are looked at together; NaN, where there is none, is looked
        at by who reads the log. counts: whether it should have changed since the step before.

        Raises RuntimeFault for one that repeats itself for too long.
        """
        values = np.atleast_1d(reading)
        if not self._seconds or not np.isfinite(values).all():
            return
        since_before, self._before = now - self._before, now
        if not np.array_equal(values, self._last):
            self._last, self._since, self._stood = values, now, 0.0
            return
        self._stood += since_before if counts else 0.0
        if self._stood >= self._seconds - CLOSE:
            shown = ", ".join(f"{value:g}" for value in values)
            raise RuntimeFault(
                f"{self._channel} has been {shown if len(values) == 1 else f'({shown})'} to the last digit for "
                f"{self._stood:.1f} s of {self._of}, since time {self._since:.3f}: it is not being read, and "
                f"{self._so}. {self._remedy}"
            )


class RowSensors:
    """What has to go on measuring while a row is recorded. channels: those of its log; current, speed: s for which the
    pack's current, and the trunk's speed while the joints move, may repeat themselves; 0: for ever."""

    def __init__(self, channels: Iterable[str], current: float, speed: float) -> None:
        self._missing = Missing(channels)
        self._current = Repeats("battery_current", current)
        self._speed = Repeats("base_velocity", speed, SEE_AGAIN)
        self._squares = deque[tuple[float, float]]()

    def see(self, state: State) -> None:
        """A step's state. Raises RuntimeFault where one of them no longer measures."""
        self._current.see(state.current, state.received)
        self._speed.see(state.velocity, state.received, self._moving(state))
        self._missing.see(state)

    def _moving(self, state: State) -> bool:
        """Whether the joints move, in the mean over the last OVER s: within a stride all may be slow for a moment."""
        self._squares.append((state.received, float(np.mean(state.dq**2))))
        while self._squares[0][0] < state.received - OVER:
            self._squares.popleft()
        return sum(square for _, square in self._squares) > len(self._squares) * MOVING**2


class Missing:
    """Looks at channels that the robot measures, a state a step."""

    def __init__(self, channels: Iterable[str]) -> None:
        self._channels, self._since = tuple(channels), dict[str, float]()

    def see(self, state: State) -> None:
        """Raises RuntimeFault for one of which there have been no numbers for too long."""
        for name in self._channels:
            since = self._since.setdefault(name, state.received)
            if holds(state, name):
                self._since[name] = state.received
            elif state.received - since >= REAL - CLOSE:
                raise RuntimeFault(
                    f"{name} has no numbers any more, since time {since:.3f}: it is not being read, so no limit of it "
                    "would stop the robot, and no row without it is of use. Start the robot's own process that reads "
                    "it again, then run the same again; rows that have a log stay."
                )


def _changed(before: State, after: State) -> np.ndarray:
    """Which channels have changed, a mask."""
    trunk = [(after.gyro != before.gyro).any(), (after.quaternion != before.quaternion).any()]
    return np.concatenate([after.q != before.q, after.dq != before.dq, trunk])


def _shown(state: State, channel: int) -> str:
    """Numbers of a channel."""
    if channel < 2 * J:
        return f"{np.concatenate([state.q, state.dq])[channel]:.3f}"
    values = state.gyro if channel == 2 * J else state.gravity
    return "(" + ", ".join(f"{value:.3f}" for value in values) + ")"
