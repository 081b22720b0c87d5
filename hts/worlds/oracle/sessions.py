"""Robots of a reality side by side, each in a session of its own, that only joint targets drive."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from hts.contracts import Instrument, Robot
from hts.errors import WorldError
from hts.worlds.twin.parameters import TwinSettings
from hts.worlds.twin.session import Batch

SESSION_SECONDS = 600.0  # then charge, air, floor and operator are those of another session
SETTLE_SECONDS = (3.0, 20.0)  # heat becomes that of the walk so far, as in the warm-up of a head-to-head


class Sessions:
    """W robots of one make. They end their sessions together and begin new ones with `renew`.

    instruments: makes fresh ones; key: of their randomness, together with the number of the session.
    readings: what the robots' sensors show, channel -> (W, ...); truth: what instruments hide, channel -> (W,).
    """

    def __init__(
        self,
        robot: Robot,
        settings: TwinSettings,
        instruments: Callable[[], dict[str, Instrument]],
        count: int,
        key: Sequence[int],
    ) -> None:
        self._make = lambda number: Batch(robot, settings, instruments(), count, np.random.SeedSequence([*key, number]))
        self._number = 0
        self._begin()

    def _begin(self) -> None:
        self.batch = self._make(self._number)
        self._number += 1
        self.seconds = 0.0
        self._settled = 0  # how often heat was
        self.look(0.0)
        self._ask()

    @property
    def over(self) -> bool:
        """Whether these sessions have lasted long enough."""
        return self.seconds > SESSION_SECONDS

    def renew(self) -> None:
        """Other sessions, from standing."""
        self.batch.close()
        self._begin()

    def step(self, targets: np.ndarray) -> None:
        """One control step with joint targets (W, J), rad."""
        batch = self.batch
        batch.supply()
        batch.body.advance(targets, batch.steps, tuple(batch.instruments.values()))
        self.seconds += batch.period
        if self._settled < len(SETTLE_SECONDS) and self.seconds >= SETTLE_SECONDS[self._settled]:
            self._settled += 1
            self._settle()
        self.look(batch.period)
        self._ask()

    def stand(self, mask: np.ndarray) -> None:
        """Set the robots of the mask (W,) down again in the default pose."""
        self.batch.body.stand(mask)
        self.look(0.0)

    def look(self, period: float) -> None:
        """Read the sensors; period: s since they were last read."""
        self.readings = self.batch.sensors.read(period)

    def close(self) -> None:
        """Let go of the engine's memory."""
        self.batch.close()

    def _ask(self) -> None:
        told = (instrument.truth() for instrument in self.batch.instruments.values())
        self.truth = {name: np.array(values) for one in told for name, values in one.items()}

    def _settle(self) -> None:
        """Steady heat. Where there is none for a policy that explores, it warms up as it goes: a session is shorter
        than the burning of a motor."""
        for instrument in self.batch.instruments.values():
            try:
                instrument.settle()
            except WorldError:
                self._settled = len(SETTLE_SECONDS)
