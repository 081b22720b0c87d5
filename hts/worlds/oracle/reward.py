"""What the oracle pays for: the truth behind an objective's channel, in standard deviations of where it begins."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import torch
from tensordict.utils import NestedKey
from torch import Tensor

from hts.contracts import Objective
from hts.measurement.transform import Measured
from hts.worlds.oracle.env import TRUE


@dataclass(frozen=True)
class Level:
    """Mean and standard deviation of a true quantity, in its instrument's unit."""

    mean: float
    std: float


class TrueReward(Measured):
    """r_real = objective.reward((truth - mean) / std), per second: what a model that never errs would pay.

    Writes ("measured", target) and ("real_reward", objective), each [P, N, 1], as a `MeasurementTransform` does.
    """

    def __init__(self, objective: Objective, level: Level) -> None:
        target = objective.target.name
        super().__init__((TRUE + target,), (("measured", target), ("real_reward", objective.name)))
        self.objective, self.level = objective, level

    def record(self, channels: Mapping[str, Tensor]) -> Tensor:
        return channels[self.inputs[0]].reshape(-1, 1)

    def evaluate(self, recorded: Tensor) -> dict[NestedKey, Tensor]:
        measured, real_reward = self.out_keys
        score = (recorded - self.level.mean) / self.level.std
        return {measured: score, real_reward: self.objective.reward(score)}

    def forward_sequence(self, recorded: Tensor, ended: torch.Tensor) -> dict[NestedKey, Tensor]:
        return self.evaluate(recorded)
