"""The way of joint targets from the policy to the drives: a fixed delay; in some realities jitter and loss."""

from __future__ import annotations

import numpy as np

from hts.worlds.twin.structure import BodyStructure

NEVER = -1


class Link:
    """Targets on their way to W robots. Time is counted in physics steps.

    A later target cannot overtake an earlier one: jitter is shorter than a control step. now: the step that begins;
    arrivals: of P packets that are on their way, in the order of sending, (P, W); sent: what is in them, (P, W, J).
    """

    def __init__(
        self, delay_steps: int, structure: BodyStructure, dt: float, num_worlds: int, rng: np.random.Generator
    ) -> None:
        self._delay, self._num, self._rng = delay_steps, num_worlds, rng
        self._jitter = round(structure.command_jitter / dt)  # steps
        self._lost = structure.lost_packets
        self.now = 0
        self.arrivals = np.empty((0, num_worlds), dtype=np.int64)
        self.sent = np.empty((0, num_worlds, 0))

    def send(self, targets: np.ndarray) -> None:
        """Send targets (W, J), rad; they arrive after the delay, each robot's with its own jitter, or never."""
        arrival = np.full(self._num, self.now + self._delay)
        if self._jitter > 0:
            arrival += self._rng.integers(0, self._jitter, self._num, endpoint=True)
        if self._lost > 0:
            arrival[self._rng.random(self._num) < self._lost] = NEVER
        packet = np.array(targets, dtype=float)[None]
        if (self.arrivals < self.now).all():  # also if there are none
            self.arrivals, self.sent = arrival[None], packet
        else:
            waiting = (self.arrivals >= self.now).any(axis=1)
            self.arrivals = np.concatenate((self.arrivals[waiting], arrival[None]))
            self.sent = np.concatenate((self.sent[waiting], packet))

    def receive(self, target: np.ndarray) -> bool:
        """Write into target (W, J) what arrives in this step; whether anything does. One call a physics step."""
        came = False
        for arrival, sent in zip(self.arrivals, self.sent, strict=True):
            now = arrival == self.now
            if now.any():
                target[now] = sent[now]
                came = True
        self.now += 1
        return came

    def replace(self, mask: np.ndarray, target: np.ndarray) -> None:
        """What is on its way to the robots of the mask (W,) becomes this target (J,)."""
        if len(self.sent):
            self.sent[:, mask] = target
