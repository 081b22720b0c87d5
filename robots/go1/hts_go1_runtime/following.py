"""Whether the joints do what they are told: where commands no longer arrive, states may still come and look well.

Of each state and joint, with the target q* and the gains that were in force a delay d ago,

    asked a = clip(kp (q* - q) - kd q', +- limit) + kd q'        given m = tau + kd q'
    share = max over d of  sum(a m) / sum(a^2)                   over all joints and the last WINDOW

which is the slope of a line through 0: 1 where the motors obey. Braking is taken out of both sides, because the noise
of q' times kd would be asked of nobody. Motors that are slack, or damp themselves, carry a tenth or so. The delay from
a command to a state that shows its torque is not known, so the best of DELAYS counts.

Where the numbers come from: stand-in, default twin and all 16 development realities, 42 s each from standing up to
sitting down at 0.3 to 1.4 m/s, half of it with twice the noise of exploring (0.3 a joint), 2 % of the packets lost and
2 % late each way; six more with all gains times 0.7 or 1.3 and up to 15 ms more delay, two with 10 % lost. The smallest
share was 0.46; in the median it was 0.8 to 1.1, and 0.63 to 0.72 with gains times 0.7. With commands cut off, twelve
times in walking and standing, it was below `Limits.least_torque_share` 0.13 to 0.32 s later. No torque was read on a
real robot: `tau` has to be measured (Go1: `tauEst`).
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from hts_go1_runtime.link import NOTHING, Command, State
from hts_go1_runtime.machine import TORQUE_LIMIT

WINDOW = 0.16  # s: eight control steps; over 0.1 s a share of 0.41 was seen
DELAYS = np.arange(7) * 0.01  # s: a reality has 0.03 at most, jitter 0.01, a lost command 0.02 more
ASKED = 2.0  # N*m of each joint, root mean square: less, as of a robot that lies, tells nothing


class Following:
    """Holds what is measured against what was commanded. least: the share below which joints do not follow; 0: nobody
    is stopped by it."""

    def __init__(self, least: float) -> None:
        self._least = least
        self._sent: deque[tuple[float, Command]] = deque([(-np.inf, NOTHING)])
        self._seen: deque[tuple[float, np.ndarray]] = deque()

    def sent(self, command: Command, now: float) -> None:
        """A command has left."""
        self._sent.append((now, command))
        while len(self._sent) > 1 and self._sent[1][0] < now - WINDOW:
            self._sent.popleft()

    def state(self, state: State) -> str:
        """How it shows that the joints do not follow; "" if they do, or if too little was asked to tell."""
        if not self._least:
            return ""
        now, seen = state.received, self._seen
        seen.append((now, self._compared(state)))
        while len(seen) > 1 and seen[1][0] <= now - WINDOW:
            seen.popleft()
        if now - seen[0][0] < WINDOW:
            return ""
        given, asked = np.sum([one for _, one in seen], axis=0)  # (2, delays)
        if asked.min() < ASKED**2 * state.q.size * len(seen):
            return ""
        share = float((given / asked).max())
        if share >= self._least:
            return ""
        return (
            f"the joints give {math.floor(100 * share)} % of the torque that their targets ask for, at least "
            f"{100 * self._least:.0f} %: commands do not reach the motors, or the robot damps itself. Look at the line "
            "to the robot and at the program beside its SDK"
        )

    def _compared(self, state: State) -> np.ndarray:
        """sum(a m) and sum(a^2) of the joints for each of DELAYS, (2, delays)."""
        found = np.empty((2, len(DELAYS)))
        last = None
        for number, delay in enumerate(DELAYS):
            command = next((one for at, one in reversed(self._sent) if at <= state.received - delay), self._sent[0][1])
            if command is not last:
                braking = command.kd * state.dq
                wanted = command.kp * (command.q - state.q) - braking
                asked = np.minimum(np.maximum(wanted, -TORQUE_LIMIT), TORQUE_LIMIT) + braking
                sums, last = (asked @ (state.tau + braking), asked @ asked), command
            found[:, number] = sums
        return found
