"""Recordings whose target is a known function of their inputs, to try measurement models on."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from hts.channels import Channel
from hts.config import Command, Named, ScheduleConfig
from hts.contracts import Comparison, Objective, Signals
from hts.recordings.recording import Recording, Series

if TYPE_CHECKING:
    from torch import Tensor

    from hts.evaluation.segments import Segments

EFFORT, RATE, HEAT = Channel("effort", "N*m", (3,)), Channel("rate", "rad/s", (3,)), Channel("heat", "W")
SIGNALS = Signals((EFFORT, RATE), HEAT, 50.0)


class KnownHeat(Objective):
    """Reward less of the made-up channel `heat`; the stand-in is right but for scale, offset, delay and smoothing."""

    name, unit, inputs, target = "cool", "1", ("effort", "rate"), HEAT

    def measurement_model(self) -> Named:
        return Named(name="lstm", hidden=16, products=True, stream=250, batch=4)

    def reward(self, prediction: Tensor) -> Tensor:
        return -prediction

    def score(self, segments: Segments) -> Mapping[str, np.ndarray]:
        return {"heat": segments.values("heat").mean(1)}

    def compare(self, policy: Mapping[str, float], reference: Mapping[str, float]) -> Comparison:
        saving = 1.0 - policy["heat"] / reference["heat"]
        return Comparison(saving, saving)

    def proxy(self, channels: Mapping[str, Tensor]) -> Tensor:
        return (channels["effort"] * channels["rate"]).sum(-1)


def known_heat(
    seed: int, policy: str = "a", seconds: float = 20.0, speed: float = 0.8, gait: float = 1.0, **changes: object
) -> Recording:
    """A gait of random size and phase, 50 Hz, and heat(t) = 5 + 2 · mean over 5 samples of Σ effort·rate,
    2 samples late.

    policy: its hash; speed: commanded, m/s; gait: size of the movement; changes: fields of the recording.
    """
    rng = np.random.default_rng(seed)
    count = round(seconds * 50)
    phase = 2 * np.pi * 2.2 * np.arange(count + 20) / 50 + rng.normal(0, 0.2, count + 20).cumsum() * 0.3
    phase = phase[:, None] + np.array([0.0, 2.0, 4.0])
    swell = 1.0 + 0.4 * np.sin(np.arange(count + 20) / 60 + seed)[:, None]
    effort = gait * swell * np.sin(phase) + rng.normal(0, 0.2, (count + 20, 3))
    rate = gait * swell * np.sin(phase + 0.7) + rng.normal(0, 0.2, (count + 20, 3))
    instant = (effort * rate).sum(1)
    heat = 5.0 + 2.0 * np.convolve(instant, np.full(5, 0.2))[: count + 20]
    values = {EFFORT: effort[20:], RATE: rate[20:], HEAT: heat[18:-2]}
    fields = {
        "robot": "fake",
        "world": "bench",
        "policy_hash": policy,
        "iteration": 0,
        "joint_names": ("x", "y", "z"),
        "kp": (1.0,) * 3,
        "kd": (0.1,) * 3,
        "rate_hz": 50.0,
        "idle": {"heat": 5.0},
        "clock": "simulated",
        "schedule": ScheduleConfig(commands=(Command(seconds=seconds, vx=speed),)),
        "time": np.arange(count) / 50,
        "channels": {c.name: Series(c, v) for c, v in values.items()},
    }
    return Recording(**(fields | changes))  # type: ignore[arg-type]
