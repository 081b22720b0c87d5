"""The objective `noise`: a first, plain version.

The target is the A-weighted level that a microphone hears. The score is the equivalent level: levels are averaged as
sound energy, since a loud second is not made up for by a quiet one.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from pydantic import Field

from hts.channels import Channel
from hts.config import Config
from hts.contracts import Comparison, Objective

if TYPE_CHECKING:
    import torch

    from hts.evaluation.segments import Segments


class NoiseSettings(Config):
    """Settings of objective `noise`."""

    weights: tuple[float, ...] = Field(
        (0.5, 1.0, 5.0), min_length=1, description="λ swept, reward per second and standard deviation of the level"
    )
    hidden: int = Field(64, ge=1, description="units of the measurement model")


class Noise(Objective):
    """Stepping noise. λ applies to −ẑ per second, ẑ the predicted level in standard deviations of its training data."""

    name = "noise"
    unit = "dB(A)"
    inputs = ("joint_torque", "joint_velocity", "foot_force")
    target = Channel("sound_level", "dB(A)", (), "fast A-weighted level 1 m from the robot")
    instrument = "microphone"

    def __init__(self, settings: NoiseSettings | None = None) -> None:
        self.settings = settings or NoiseSettings()
        self.weights = self.settings.weights

    def measurement_model(self) -> Any:
        from hts.measurement.models import MeasurementModelConfig

        return MeasurementModelConfig(inputs=self.inputs, target=self.target.name, hidden=self.settings.hidden)

    def reward(self, prediction: torch.Tensor) -> torch.Tensor:
        """−ẑ, per second."""
        return -prediction

    def score(self, segments: Segments) -> Mapping[str, np.ndarray]:
        """sound_energy of each segment: mean of 10^(L/10), that is mean squared pressure over (20 uPa)^2."""
        return {"sound_energy": (10.0 ** (segments.values("sound_level").astype(float) / 10)).mean(-1)}

    def compare(self, policy: Mapping[str, float], reference: Mapping[str, float]) -> Comparison:
        """How much quieter, dB(A): 10 log10 of the ratio of mean sound energies."""
        quieter = 10.0 * float(np.log10(reference["sound_energy"] / policy["sound_energy"]))
        return Comparison(quieter, quieter, {"equivalent_level": 10.0 * float(np.log10(policy["sound_energy"]))})
