"""The instrument `fake_meter`: the sensor of `fake_level` on a simulated robot. Learning code never sees it.

On a twin it stands for what a simulator gets wrong, so it should hold what your sensor does: its physics, its
slowness, its noise. As it stands, with W robots, J joints, torque τ N·m and speed q̇ rad/s of each:

    level = idle + Σ_J (|τ q̇| + loss τ²)      then a first-order delay, then noise
"""

from __future__ import annotations

import numpy as np
from pydantic import Field

from hts.config import Config
from hts.contracts import Instrument
from hts.testing.examples.objective.objective import TARGET


class Settings(Config):
    """Settings of the instrument: `--set world.instruments.fake_meter.noise=0.2`."""

    idle: float = Field(5.0, ge=0, description="reading with electronics on and motors idle, W")
    loss: float = Field(0.2, ge=0, description="heat of holding a torque, W/(N·m)²")
    delay: float = Field(0.1, gt=0, description="time constant of the reading, s")
    noise: float = Field(0.1, ge=0, description="standard deviation of a reading, W")


class Meter(Instrument):
    """One sensor on each of W robots."""

    channels = (TARGET,)

    def __init__(self, settings: Settings | None = None) -> None:
        self.settings = settings or Settings()

    def reset(self, num_worlds, rng):
        self.rng = rng
        self.level = np.full(num_worlds, self.settings.idle)

    def step(self, sample):
        torque, speed = sample.motor_torque, sample.joint_velocity
        now = self.settings.idle + (np.abs(torque * speed) + self.settings.loss * torque**2).sum(axis=-1)
        self.level = self.level + (now - self.level) * min(1.0, sample.dt / self.settings.delay)

    def read(self):
        return {TARGET.name: self.level + self.settings.noise * self.rng.standard_normal(self.level.shape)}

    def idle(self):
        return {TARGET.name: self.settings.idle}

    def describe(self):
        return self.settings.model_dump()
