"""The objective `fake`: what is measured, what predicts it, what counts as better.

As it stands: the work that the joints do per second, in W, as one sensor on the robot reads it; less is better.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated

from pydantic import Field

from hts.channels import Channel
from hts.config import Config, Named
from hts.contracts import Comparison, Objective

if TYPE_CHECKING:
    import numpy as np
    import torch

    from hts.evaluation.segments import Segments

# The real channel: its name in recordings and logs, its unit (hts.units), the shape of a sample, what it is.
TARGET = Channel("fake_level", "W", (), "what the sensor on the robot reads")


Weight = Annotated[float, Field(ge=0, allow_inf_nan=False)]  # below 0, λ would reward more of the target


class Settings(Config):
    """Settings of the objective: `--set objectives.fake.hidden=32`. A key that is not here is refused."""

    weights: tuple[Weight, ...] = Field(
        (0.5, 1.0, 5.0), min_length=1, description="λ swept, reward per second and standard deviation of the target"
    )
    baseline_weights: tuple[Weight, ...] = Field(
        (0.001, 0.01), min_length=1, description="λ swept by `hts baseline`, reward per second and unit of the proxy"
    )
    hidden: int = Field(64, ge=1, description="units of the measurement model")


class Fake(Objective):
    """Less of the target. The improvement is the saved fraction of what lies above the idle level."""

    name = "fake"
    unit = "1"  # of the improvement: a fraction; it could be any of hts.units
    inputs = ("joint_torque", "joint_velocity")  # sim channels: what simulation and robot both give
    target = TARGET
    instrument = "fake_meter"  # measures the target on a twin; None: only a real robot can

    def __init__(self, settings: Settings | None = None) -> None:
        self.settings = settings or Settings()
        self.weights = self.settings.weights
        self.baseline_weights = self.settings.baseline_weights

    def measurement_model(self) -> Named:
        """A small recurrent network from `inputs` to `target`, by its registered name (`hts plugins` lists them)."""
        return Named(name="lstm", hidden=self.settings.hidden)

    def reward(self, prediction: torch.Tensor) -> torch.Tensor:
        """More reward for less of it: minus the prediction, which is in standard deviations of the recorded data.

        Drop the minus if more is better. Never clip it, and let NaN stay NaN: a 0 would be the best reward there is.
        """
        return -prediction

    def score(self, segments: Segments) -> Mapping[str, np.ndarray]:
        """What each second of walking took, W: above the idle level and in all, each (segments,)."""
        gross = segments.values(self.target.name).mean(axis=1)
        return {"net": gross - segments.idle(self.target.name), "gross": gross}

    def compare(self, policy: Mapping[str, float], reference: Mapping[str, float]) -> Comparison:
        """From the means of `score`: improvement (larger is better), what the selector ranks by, and other numbers."""
        saved = 1.0 - policy["net"] / reference["net"]
        return Comparison(saved, saved, {"gross_reduction": 1.0 - policy["gross"] / reference["gross"]})

    def proxy(self, channels: Mapping[str, torch.Tensor]) -> torch.Tensor:
        """What one would put into simulation without measuring: work rate of all joints, W, (..., J) -> (...,)."""
        return (channels["joint_torque"] * channels["joint_velocity"]).abs().sum(-1)
