"""To and fro on a straight of a stated length: where a row would leave the room the robot turns round, and goes on.

A step has a phase, which says what was commanded in it:

    STRAIGHT   what the row asks for; the only steps that count
    TURNING    round, to the left, at one forward speed and yaw rate for all policies of the bundle
    SETTLING   the row's speed on the new leg, for as long as is left out after a swap of policies

A turn begins where the robot is at the end of the straight by the measured speed, turned along the lane by the IMU
(without a speed sensor: by the commanded one). Nothing measured decides which step counts, only where a leg ends.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable

import numpy as np

from hts_go1_runtime.errors import RuntimeFault
from hts_go1_runtime.heading import STRAIGHT, Heading, keeping, wrapped
from hts_go1_runtime.link import State
from hts_go1_runtime.policy import Policy
from hts_go1_runtime.trained import ranges_of, turns

TURNING, SETTLING = 1, 2
# Chosen, and tried with stand-ins alone (docs/deployment.md, In a room); none was found on a robot.
TURN_RATE, LEAST_TURN_RATE = 0.8, 0.3  # rad/s commanded in a turn; slower than the latter nobody is turned round
SLOWING = 2.0  # rad/s per rad: near its end a turn is commanded ever slower
TURNED = 0.15  # rad from the new heading at which a turn is over; the rest is the settling's
TURN_SHARE = 3.0  # a turn may take so many times what it would at the commanded rate
LOOK_SECONDS, LEAST_TURNED = 3.0, 0.25  # by then at least this share of what was commanded is turned
OTHER_WAY = 0.5  # rad turned against the command: more than a trunk sways
BACK, MOST_BACK = 0.4, 0.25  # rad per m beside the leg, rad: over 3 m of walking two thirds of it are made good
OFF, OFF_SECONDS = 0.6, 0.5  # rad off the lane's heading for so long is no swaying
BLIND, AGAINST, AGAINST_SECONDS = 0.5, 0.1, 1.0  # s; m/s, s: as while a command is trimmed
FARTHEST = 2.0, 1.0  # a leg ends the visit once so many times its length and so many m were commanded in it
LEFT, RIGHT, ROUND = "l", "r", "t"
"""Typed, then Enter."""
NUDGE = math.radians(3.0)
MOST_IDLE_LEGS = 2  # one after the other of which hardly a step counted; one may be short where the operator turned it
LEAST_SECONDS = 1.0  # of counted walking that a straight must have room for at each speed, after settling


class Lane(Heading):
    """One visit's. straight: its length, m; period: of a step, s; settle: s; turn: forward m/s and yaw rate rad/s of a
    turn; measured: whether the link gives the trunk's speed. Raises RuntimeFault, at which a robot sits down, where
    it does not turn, leaves its heading, or its speed is not to be believed."""

    def __init__(
        self,
        straight: float,
        period: float,
        settle: float,
        turn: tuple[float, float],
        measured: bool,
        say: Callable[..., None] = lambda what, **numbers: None,
    ) -> None:
        super().__init__()
        self._straight, self._period, self._settle, self._measured, self._say = straight, period, settle, measured, say
        self._forward, self._rate = turn
        self._most = TURN_SHARE * math.pi / self._rate
        self.phase = STRAIGHT
        self._axis: float | None = None  # heading of the way out
        self._at, self._aside, self._out = 0.0, 0.0, True  # m along the axis and to its left; whether it walks out
        self._leg, self._told = straight, 0.0  # m that were left as this leg began, and that were commanded in it
        self._seconds, self._turned, self._goal = 0.0, 0.0, math.pi  # of the phase; rad of the turn, and of all of it
        self._before: float | None = None  # heading a step ago
        self._last, self._blind, self._against, self._off = math.nan, 0.0, 0.0, 0.0
        self._asked_round, self._idle_legs = False, 0

    def turn_now(self) -> None:
        """The operator wants it to turn at the next step, wherever it is. From any thread."""
        self._asked_round = True

    def begin(self) -> None:
        """Another walk, on the same lane."""

    def counts(self, asked: np.ndarray) -> bool:
        """Whether the step that comes next is one of straight walking, else of a turn. asked: what the row wants, vx
        m/s, vy m/s, yaw rate rad/s."""
        if not asked.any():
            return True
        if self.phase != TURNING and (self._left() <= 0 or self._asked_round):
            self._check_counted()
            self._begins(TURNING)
            self._turned = 0.0
            self._goal = math.pi if self._before is None else (self._way(not self._out) - self._before) % (2 * math.pi)
        elif self.phase == TURNING and self._goal - self._turned <= TURNED:
            self._say("turned round", seconds=round(self._seconds, 1), along_m=round(self._at, 1))
            self._begins(SETTLING)
            self._out, self._asked_round = not self._out, False
            self._leg, self._told = self._left(), 0.0
        elif self.phase == SETTLING and self._seconds >= self._settle - self._period / 2:
            self._begins(STRAIGHT)
        return self.phase == STRAIGHT

    def steered(self, policy: Policy, asked: np.ndarray, state: State) -> np.ndarray:
        """The command (3,) of this step, with the yaw rate that turns round or keeps the heading."""
        if self._axis is None:
            self._axis = state.heading
        if not asked.any():
            return asked
        if self.phase == TURNING:
            rate = min(self._rate, SLOWING * max(self._goal - self._turned, 0.0))
            return np.array([self._forward, 0.0, rate])
        return np.array([asked[0], asked[1], keeping(policy, -self._astray(state))])

    def see(self, state: State, sent: np.ndarray) -> None:
        """The state of a step and the command (3,) that was sent in it. Raises RuntimeFault."""
        if self._axis is None or not sent.any():
            return
        nudge, self._nudged = self._nudged, 0.0
        self._axis += nudge
        self._seconds += self._period
        known = self._speed(state, sent)
        along = state.heading - self._axis
        self._at += self._period * (known[0] * math.cos(along) - known[1] * math.sin(along))
        if self._measured:
            self._aside += self._period * (known[0] * math.sin(along) + known[1] * math.cos(along))
        if self.phase == TURNING:
            self._see_turn(state)
        else:
            self._see_leg(state, sent)
        self._before = state.heading

    # ------------------------------------------------------------------------------------------ inside

    def _begins(self, phase: int) -> None:
        self.phase, self._seconds, self._against, self._off = phase, 0.0, 0.0, 0.0

    def _left(self) -> float:
        """Metres of the straight ahead; negative beyond its end."""
        return self._straight - self._at if self._out else self._at

    def _astray(self, state: State) -> float:
        """Heading to the left of where it is to walk, rad."""
        return wrapped(state.heading - self._way(self._out))

    def _way(self, out: bool) -> float:
        """The heading that leads along a leg, and back to it from beside it, rad. The way back lies beside the way out
        by the width of a turn."""
        assert self._axis is not None
        beside = self._aside if out else 2 * self._forward / self._rate - self._aside
        return self._axis + (0.0 if out else math.pi) - min(max(BACK * beside, -MOST_BACK), MOST_BACK)

    def _check_counted(self) -> None:
        """Raise RuntimeFault where hardly a step of leg after leg counts: the robot would turn for ever."""
        counted = self._seconds if self.phase == STRAIGHT else 0.0
        self._idle_legs = 0 if counted >= LEAST_SECONDS / 2 or self._asked_round else self._idle_legs + 1
        if self._idle_legs > MOST_IDLE_LEGS:
            raise RuntimeFault(
                f"The straight of {self._straight:g} m is walked while the robot settles ({self._settle:g} s after "
                "each turn), so hardly a step of it counts. Give a longer --straight, if the room has it, or record "
                "this row on a track; rows that have a log stay."
            )

    def _speed(self, state: State, sent: np.ndarray) -> tuple[float, float]:
        """Forward and to the left, m/s: measured, or where there is no number what was commanded."""
        forward, left = float(state.velocity[0]), float(state.velocity[1])
        fresh = math.isfinite(forward) and forward != self._last
        self._last = forward
        self._blind = 0.0 if fresh else self._blind + self._period
        if self._measured and self._blind > BLIND:
            raise RuntimeFault(
                f"The sensor of the trunk's speed has given nothing new for {BLIND:g} s, and by it the robot knows "
                "where the straight ends. See that it sees the robot all along the straight and in the turns, then run "
                "the same again."
            )
        if not math.isfinite(forward):
            return float(sent[0]), 0.0
        return forward, left if math.isfinite(left) else 0.0

    def _see_turn(self, state: State) -> None:
        if self._before is not None:
            self._turned += wrapped(state.heading - self._before)
        degrees, seconds = math.degrees(self._turned), self._seconds
        if self._turned < -OTHER_WAY:
            raise RuntimeFault(
                f"Told to turn to the left, its heading went {-degrees:.0f} degrees to the right: the IMU's yaw counts "
                "the other way (expected: the quaternion w, x, y, z of the trunk, z up), or the policy turns against "
                "its command. Correct the link, then run the same again; rows that have a log stay."
            )
        if (seconds > LOOK_SECONDS and self._turned < LEAST_TURNED * self._rate * seconds) or seconds > self._most:
            raise RuntimeFault(
                f"Told to turn round at {self._rate:g} rad/s, its heading changed by {degrees:.0f} of 180 degrees in "
                f"{seconds:.1f} s: this policy does not turn, or the IMU's yaw is not measured. Record it on a track, "
                "without --straight; rows that have a log stay."
            )

    def _see_leg(self, state: State, sent: np.ndarray) -> None:
        self._told += self._period * float(sent[0])
        forward = float(state.velocity[0])
        self._against = self._against + self._period if forward < -AGAINST < 0 < sent[0] else 0.0
        self._off = self._off + self._period if abs(self._astray(state)) > OFF else 0.0
        if self._against >= AGAINST_SECONDS:
            raise RuntimeFault(
                f"The sensor of the trunk's speed has shown {forward:.2f} m/s, backwards, for {AGAINST_SECONDS:g} s in "
                f"which the robot was told {sent[0]:.2f} m/s: by it nobody knows where the straight ends. Correct it "
                "(x forward in the trunk's frame), then run the same again."
            )
        if self._off >= OFF_SECONDS:
            raise RuntimeFault(
                f"Its heading is {math.degrees(abs(self._astray(state))):.0f} degrees off the straight: the IMU's yaw "
                "is not to be believed, or the policy does not keep its heading. Look at both, then run the same "
                "again; rows that have a log stay."
            )
        times, more = FARTHEST
        if self._told > times * max(self._leg, 0.0) + more and self._left() > 0:
            raise RuntimeFault(
                f"Told to walk {self._told:.1f} m since it turned, and by the sensor of the trunk's speed it still has "
                f"{self._left():.1f} m of the straight ahead: it shows less than half of what was commanded. Correct "
                "it (m/s); a robot that does walk so slowly needs no --straight."
            )


def turn_of(policies: Iterable[Policy], scale: float = 1.0) -> tuple[float, float]:
    """Forward speed m/s and yaw rate rad/s, to the left, that turn every one of a visit's policies round within what it
    was trained with: on the spot where all know how, else in an arc. scale: of the yaw rate, of a first run. Raises
    RuntimeFault for a policy that was not trained to turn."""
    forward, rate = 0.0, TURN_RATE
    for policy in policies:
        ranges = ranges_of(policy)
        forward = max(forward, ranges.get("vx", (0.0, 0.0))[0])
        rate = min(rate, turns(ranges, TURN_RATE)[1])
        if rate < LEAST_TURN_RATE:
            low, high = ranges["yaw_rate"]
            raise RuntimeFault(
                f"{policy.where}: was trained with yaw rates from {low:g} to {high:g} rad/s, and to turn round at the "
                f"end of a straight it needs {LEAST_TURN_RATE:g} to the left. Record it on a track, without --straight."
            )
    return forward, scale * rate


def keys_of(heading: Heading) -> dict[str, Callable[[], None]]:
    """What the operator's keys do to where a robot walks."""
    keys: dict[str, Callable[[], None]] = {
        LEFT: lambda: heading.nudge(NUDGE),
        RIGHT: lambda: heading.nudge(-NUDGE),
    }
    return {**keys, ROUND: heading.turn_now} if isinstance(heading, Lane) else keys
