"""The instrument `warmth`: a sensor of a real channel on a simulated robot. Learning code never sees it.

It should hold what your sensor does: its physics, its slowness, its noise. As it stands: how much warmer the motors
are than the air, on average over the joints, with torque τ N·m,

    C dT/dt = loss τ² − T / R        T: K        then noise

An objective gets it by `instrument = "warmth"` in its class; a twin also carries it where its settings name it.
What remembers minutes, as this temperature does, stands beside a target (`also_measured`) and is none: no model of the
last second can tell it, and the policy before has a share in it. The target is then what heats, in W, now.
"""

from __future__ import annotations

import numpy as np
from pydantic import Field

from hts.channels import Channel
from hts.config import Config
from hts.contracts import Instrument

CHANNEL = Channel("warmth_reading", "K", (), "how much warmer the motors are than the air")


class Settings(Config):
    """Settings of the instrument: `--set world.instruments.warmth.noise=0.05`. Each needs a source: say which."""

    loss: float = Field(2.0, gt=0, description="heat per squared torque, W/(N·m)²; made up")
    resistance: float = Field(1.5, gt=0, description="R, from a motor to the air, K/W; made up")
    capacity: float = Field(40.0, gt=0, description="C, of a motor, J/K; made up")
    noise: float = Field(0.02, ge=0, description="standard deviation of a reading, K; made up")


class Warmth(Instrument):
    """One sensor on each of W robots; a policy leaves its heat to the next one."""

    channels = (CHANNEL,)

    def __init__(self, settings: Settings | None = None) -> None:
        self.settings = settings or Settings()

    def reset(self, num_worlds, rng):
        self.rng = rng
        self.kelvin = np.zeros(num_worlds)
        self.heat, self.seconds = np.zeros(num_worlds), 0.0  # J a motor, since the last reset or settle

    def step(self, sample):
        watts = self.settings.loss * (sample.motor_torque**2).mean(axis=-1)
        flow = watts - self.kelvin / self.settings.resistance
        self.kelvin = self.kelvin + flow * sample.dt / self.settings.capacity
        self.heat = self.heat + watts * sample.dt
        self.seconds += sample.dt

    def read(self):
        return {CHANNEL.name: self.kelvin + self.settings.noise * self.rng.standard_normal(self.kelvin.shape)}

    def idle(self):
        """As someone would read it off: electronics on, motors idle."""
        return {CHANNEL.name: 0.0}

    def settle(self):
        """Where T ends if the walk goes on for ever: T = R times the mean heat."""
        if self.seconds > 0:
            self.kelvin = self.settings.resistance * self.heat / self.seconds
        self.heat, self.seconds = np.zeros_like(self.heat), 0.0

    def describe(self):
        return self.settings.model_dump()
