"""An instrument that remembers."""

from __future__ import annotations

from hts.contracts import Instrument, PhysicsSample


class Witness(Instrument):
    """Keeps every physics sample, and counts what it is told."""

    channels = ()

    def reset(self, num_worlds, rng):
        self.torque, self.settled = [], 0

    def step(self, sample: PhysicsSample):
        self.torque.append(sample.motor_torque.copy())

    def read(self):
        return {}

    def idle(self):
        return {}

    def settle(self):
        self.settled += 1
