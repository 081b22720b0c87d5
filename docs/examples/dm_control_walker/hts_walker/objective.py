"""The objective `effort`: electrical energy per metre, as a meter in the lab shows it. No simulation here knows it."""

from __future__ import annotations

from pydantic import Field

from hts.channels import Channel
from hts.config import Config, Named
from hts.contracts import Comparison, Objective

POWER = Channel("motor_power", "W", (), "electrical power, with what the electronics take")


class Settings(Config):
    """Settings of the objective: `--set objectives.effort.hidden=16`."""

    hidden: int = Field(32, ge=1, description="units of the measurement model")


class Effort(Objective):
    """Less energy per metre is better. The improvement is the fraction saved of what is above the idle level."""

    name = "effort"
    unit = "1"
    inputs = ("joint_torque", "joint_velocity")
    target = POWER
    weights = (0.1, 0.5)
    baseline_weights = (0.0005, 0.002)

    def __init__(self, settings: Settings) -> None:
        self.settings = settings

    def measurement_model(self):
        return Named(name="lstm", hidden=self.settings.hidden, sequence=20, stream=100)

    def reward(self, prediction):
        return -prediction

    def score(self, segments):
        power = segments.values(self.target.name).mean(axis=1) - segments.idle(self.target.name)
        return {"net_power": power, "speed": segments.speed}

    def compare(self, policy, reference):
        """By energy per metre: the task has a lowest speed and no highest one, and slower walking must not count."""
        per_metre, before = (means["net_power"] / means["speed"] for means in (policy, reference))
        saved = 1.0 - per_metre / before
        return Comparison(saved, saved, {"joule_per_metre": per_metre})

    def proxy(self, channels):
        """Mechanical work, what somebody without a meter would reduce, W."""
        return (channels["joint_torque"] * channels["joint_velocity"]).clamp(min=0.0).sum(-1)
