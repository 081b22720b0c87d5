"""The measurement model `fading`: from sim channels to what only the robot measures.

As it stands: a weighted sum of exponential averages of the inputs and their products,

    z(t) = b + w · m(t)        m(t) = m(t − 1) + a (φ(t) − m(t − 1))        φ: z-scored features

with w and b by least squares, and a, how quickly the past is forgotten, the best of a few. It is what a sensor with a
delay asks for, and little to learn. Replace `fit`, `sequence` and `step` by yours; the memory, here m, may have any
shape.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from typing import Any

import torch
from pydantic import Field

from hts.config import Config
from hts.contracts import Prediction, Signals
from hts.measurement.data import split_ends, training_data
from hts.measurement.torch_model import TorchModel


class Settings(Config):
    """Settings of the model: `--set objectives.NAME.model.products=false`. A key that is not here is refused."""

    products: bool = Field(True, description="also feed squares, and products of inputs of one size, place by place")
    seconds: tuple[float, ...] = Field((0.02, 0.05, 0.1, 0.2, 0.4), min_length=1, description="time constants tried, s")
    ridge: float = Field(1e-3, ge=0, description="penalty on squared weights, per sample")


class Fading(TorchModel):
    """Its numbers: buffers, in the shapes that they keep.
    `TorchModel` brings statistics, z-scores, files and devices."""

    def __init__(self, config: Settings, signals: Signals) -> None:
        super().__init__(signals, config.products)
        self.config = config
        self.register_buffer("share", torch.tensor(1.0))  # a
        self.register_buffer("weight", torch.zeros(self.num_features))  # w
        self.register_buffer("bias", torch.tensor(0.0))  # b
        self.register_buffer("error", torch.tensor(0.0))  # standard deviation of what is left over, z-scored

    @property
    def settings(self) -> Mapping[str, Any]:
        return self.config.model_dump(mode="json")

    @torch.no_grad()
    def fit(self, recordings, *, seed=0, epochs=20, max_seconds=math.inf, progress=None, warm_start=None):
        """Solved in one go, so seed, epochs and warm start change nothing."""
        began = time.monotonic()
        pieces = training_data(self.signals, recordings)  # checked, in channel units
        self.set_statistics(torch.cat([one.inputs for one in pieces]), torch.cat([one.target for one in pieces]))
        training, ends = split_ends(pieces, run_in=50)
        best = math.inf
        for seconds in self.config.seconds:
            share = 1.0 - math.exp(-1.0 / (seconds * self.signals.rate_hz))
            solution = self._solved(*self._design(training, share))
            design, target = self._design(ends or training, share)
            error = float((design @ solution - target).square().mean())
            if error < best:
                best = error
                self.share.fill_(share)
                self.weight.copy_(solution[:-1])
                self.bias.copy_(solution[-1])
                self.error.fill_(math.sqrt(error))
        if progress is not None:
            progress(1, 1, best)
        return {"samples": sum(len(one.target) for one in pieces), "mse": best, "seconds": time.monotonic() - began}

    def _design(self, pieces, share):
        """Averages and a column of ones, (samples, G + 1), and the z-scored target, of all scored samples."""
        rows, targets = [], []
        for one in pieces:
            features = self.scaled_features(one.inputs)[None]
            averages, _ = _averages(features, share, torch.zeros_like(features[:, 0]))
            ones = torch.ones(len(one.target), 1)
            rows.append(torch.cat((averages[0], ones), 1)[one.skip :])
            targets.append(self.normalise_target(one.target)[one.skip :])
        return torch.cat(rows).double(), torch.cat(targets).double()

    def _solved(self, design, target):
        """argmin |Xw − y|² + ridge · samples · |w|²"""
        penalty = (self.config.ridge + 1e-9) * len(target) * torch.eye(design.shape[1], dtype=torch.double)
        return torch.linalg.solve(design.T @ design + penalty, design.T @ target)

    # What follows runs in the training env: no value is looked at, no world sees another.

    def initial_state(self, num_worlds):
        return torch.zeros(num_worlds, self.num_features, device=self.device)

    def step(self, inputs, state):
        state = state + self.share * (self.scaled_features(inputs) - state)
        return self._read(state), state

    def sequence(self, inputs, state=None):
        start = self.initial_state(len(inputs)) if state is None else state
        averages, state = _averages(self.scaled_features(inputs), self.share, start)
        return self._read(averages), state

    def _read(self, averages):
        """Mean and standard deviation from averages (..., G); a model that knows no deviation gives the mean alone."""
        mean = averages @ self.weight + self.bias
        return Prediction(mean, self.error.expand(mean.shape))


def _averages(features, share, state):
    """Exponential averages along features (B, T, G), from state (B, G): (B, T, G) and the last one."""
    found = []
    for now in features.unbind(1):
        state = state + share * (now - state)
        found.append(state)
    return torch.stack(found, 1), state
