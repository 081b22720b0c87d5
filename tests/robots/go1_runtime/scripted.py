"""A link to a robot that is a few lines of script, on a clock of its own."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np

from hts_go1_runtime.fake import noisy, standing
from hts_go1_runtime.link import Command, Counts, Link, State

STATE_SECONDS = 0.004
LAG = 0.05  # s


class ScriptedLink(Link):
    """The joints go where they are told to, within some LAG; their motors give what they are asked for.

    spoil(state) may change a state, or return None: it is lost.
    """

    simulated = True

    def __init__(self, spoil: Callable[[State], State | None] = lambda state: state) -> None:
        self.counts, self.sent = Counts(), []
        self._spoil, self._clock, self._sequence = spoil, 0.0, 0
        self._command: Command | None = None
        self.speed = 0.55
        self._pose: np.ndarray | None = None
        self._random = np.random.default_rng(0)

    def now(self) -> float:
        return self._clock

    def wait(self, until: float) -> list[State]:
        self._clock += STATE_SECONDS
        self._sequence += 1
        state = standing(self._sequence, self._clock)
        command = self._command
        pose = state.q if self._pose is None else self._pose
        wanted = pose if command is None or not command.kp.any() else command.q
        velocity = (wanted - pose) / LAG
        torque = np.zeros(12) if command is None else command.kp * (command.q - pose) - command.kd * velocity
        self._pose = pose = pose + STATE_SECONDS * velocity
        state = dataclasses.replace(
            state,
            received=self._clock,
            q=pose,
            tau=torque + self._random.standard_normal(12),
            dq=velocity,
            velocity=np.array([self.speed, 0.0, 0.0]) + 1e-3 * self._random.standard_normal(3),
            current=3.0 + 0.1 * self._random.standard_normal(),
            voltage=22.0 + 0.01 * self._random.standard_normal(),
        )
        spoilt = self._spoil(noisy(state, self._random))
        return [] if spoilt is None else [spoilt]

    def send(self, command: Command) -> None:
        self._command = command
        self.sent.append((self._clock, command))

    def close(self) -> None:
        pass
