"""The objective `noise`: walk more quietly, as a sound-level meter beside the robot hears it.

The target is the A-weighted fast level that the meter shows. What counts in the end is measured: the equivalent level,
which averages sound energy, because a loud second is not made up for by a quiet one.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np
from pydantic import Field

from hts.channels import Channel
from hts.config import Config, Named
from hts.contracts import Comparison, Objective
from hts_noise.proxy import contact_motion

if TYPE_CHECKING:
    import torch

    from hts.evaluation.segments import Segments

LOUD_PERCENTILE = 90.0  # L10: the level exceeded during 10 % of the time


Weight = Annotated[float, Field(ge=0, allow_inf_nan=False)]


class NoiseSettings(Config):
    """Settings of objective `noise`."""

    criterion: Literal["smaller", "mean"] = Field(
        "smaller",
        description="what a candidate counts with: the smaller of its gains in mean level and in sound energy per "
        "metre (slower walking is no gain), or mean level alone",
    )
    weights: tuple[Weight, ...] = Field(
        (1.0,), min_length=1, description="λ swept, reward per second and standard deviation of the level"
    )
    baseline_weights: tuple[Weight, ...] = Field(
        (1e-4, 3e-4, 1e-3, 3e-3, 1e-2), min_length=1, description="λ that `hts baseline` sweeps, per N·(rad/s)²"
    )
    proxy_weights: tuple[Weight, ...] = Field(
        (3e-3,), min_length=1, description="λ of `hts run --reward proxy`, per N·(rad/s)²"
    )
    torque: bool = Field(False, description="give the model joint torque too; see the table in docs/noise.md")
    hidden: int = Field(32, ge=1, description="units of the measurement model")
    products: bool = Field(True, description="give the model q̇² and F² beside q̇ and F")


class Noise(Objective):
    """Stepping noise. λ applies to −ẑ per second, ẑ the predicted level in standard deviations of its training data."""

    name = "noise"
    unit = "dB(A)"
    inputs: tuple[str, ...] = ("joint_velocity", "foot_force")
    target = Channel("sound_level", "dB(A)", (), "fast A-weighted level (125 ms) near the robot")
    instrument = "microphone"
    metric_units = MappingProxyType(
        {
            "sound_energy": "1",
            "sound_per_metre": "s/m",
            "loud_level": "dB(A)",
            "mean_level": "dB(A)",
            "loud_improvement": "dB(A)",
            "per_metre_improvement": "dB(A)",
        }
    )

    def __init__(self, settings: NoiseSettings | None = None) -> None:
        self.settings = settings or NoiseSettings()
        if self.settings.torque:
            self.inputs = ("joint_torque", *self.inputs)
        self.weights = self.settings.weights
        self.baseline_weights, self.proxy_weights = self.settings.baseline_weights, self.settings.proxy_weights

    def measurement_model(self) -> Named:
        """`footfall_level`, of the size that the settings ask for."""
        return Named(name="footfall_level", hidden=self.settings.hidden, products=self.settings.products)

    def reward(self, prediction: torch.Tensor) -> torch.Tensor:
        """−ẑ, per second."""
        return -prediction

    def score(self, segments: Segments) -> Mapping[str, np.ndarray]:
        """Of each segment: sound_energy, mean of 10^(L/10), which is mean squared pressure over (20 µPa)²;
        sound_per_metre, the same over speed, s/m; loud_level, its L10 in dB(A)."""
        level = segments.values(self.target.name).astype(float)
        energy = (10.0 ** (level / 10)).mean(-1)
        return {
            "sound_energy": energy,
            "sound_per_metre": energy / segments.speed,
            "loud_level": np.percentile(level, LOUD_PERCENTILE, axis=-1) if len(level) else energy,
        }

    def compare(self, policy: Mapping[str, float], reference: Mapping[str, float]) -> Comparison:
        """How much quieter, dB(A): 10 log10 of the ratio of mean sound energies."""
        quieter = lower(policy["sound_energy"], reference["sound_energy"])
        per_metre = lower(policy["sound_per_metre"], reference["sound_per_metre"])
        metrics = {
            "mean_level": 10.0 * float(np.log10(policy["sound_energy"])),
            "loud_improvement": float(reference["loud_level"] - policy["loud_level"]),
            "per_metre_improvement": per_metre,
        }
        return Comparison(
            quieter, min(quieter, per_metre) if self.settings.criterion == "smaller" else quieter, metrics
        )

    def proxy(self, channels: Mapping[str, torch.Tensor]) -> torch.Tensor:
        """What moves fast while it bears load, N·(rad/s)²; see `hts_noise.proxy`."""
        return contact_motion(channels["foot_force"], channels["joint_velocity"])


def lower(policy: float, reference: float) -> float:
    """How much lower the level of one energy is than that of another, dB."""
    return 10.0 * float(np.log10(reference / policy))
