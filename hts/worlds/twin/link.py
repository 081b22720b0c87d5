"""The way of joint targets from the policy to the drives: a fixed delay; in some realities jitter and loss."""

from __future__ import annotations

import numpy as np

from hts.worlds.twin.structure import BodyStructure

NEVER = -1


class Link:
    """Targets on their way to W robots. Time is counted in physics steps.

    A later target cannot overtake an earlier one: jitter is shorter than a control step.
    """

    def __init__(
        self, delay_steps: int, structure: BodyStructure, dt: float, num_worlds: int, rng: np.random.Generator
    ) -> None:
        self._delay, self._num, self._rng = delay_steps, num_worlds, rng
        self._jitter = round(structure.command_jitter / dt)  # steps
        self._lost = structure.lost_packets
        self._now = 0
        self._waiting: list[tuple[int, np.ndarray, np.ndarray]] = []  # last arrival, arrivals (W,), targets (W, J)

    def send(self, targets: np.ndarray) -> None:
        """Send targets (W, J), rad; they arrive after the delay, each robot's with its own jitter, or never."""
        arrival = np.full(self._num, self._now + self._delay)
        if self._jitter > 0:
            arrival += self._rng.integers(0, self._jitter, self._num, endpoint=True)
        if self._lost > 0:
            arrival[self._rng.random(self._num) < self._lost] = NEVER
        self._waiting.append((int(arrival.max()), arrival, np.array(targets, dtype=float)))

    def receive(self, target: np.ndarray) -> bool:
        """Write into target (W, J) what arrives in this step; whether anything does. One call a physics step."""
        came = False
        for _, arrival, sent in self._waiting:
            now = arrival == self._now
            if now.any():
                target[now] = sent[now]
                came = True
        self._waiting = [packet for packet in self._waiting if packet[0] > self._now]
        self._now += 1
        return came

    def replace(self, mask: np.ndarray, target: np.ndarray) -> None:
        """What is on its way to the robots of the mask (W,) becomes this target (J,)."""
        for _, _, sent in self._waiting:
            sent[mask] = target
