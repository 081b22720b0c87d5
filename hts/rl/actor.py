"""The exploring policy of a population, as a TensorDict module for TorchRL's Collector."""

from __future__ import annotations

import math

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase

from hts.rl.population import Population
from hts.rl.random import PopulationRandom

LOG_2PI = math.log(2 * math.pi)


def log_prob(action: torch.Tensor, mean: torch.Tensor, log_std: torch.Tensor) -> torch.Tensor:
    """log N(action; mean, diag exp(2 log_std)), summed over actions; [..., J] -> [...]."""
    z = (action - mean) * torch.exp(-log_std)
    return -(0.5 * z.square() + log_std + 0.5 * LOG_2PI).sum(-1)


class Explorer(TensorDictModuleBase):
    """observation [P, N, O] -> action = mean + sigma x noise [P, N, J], and its mean.

    The noise comes from a generator per candidate; with `random=None` the mean action is taken.
    """

    in_keys = ["observation"]  # noqa: RUF012 - what TensorDictModuleBase asks for
    out_keys = ["action", "action_mean"]  # noqa: RUF012

    def __init__(self, population: Population, random: PopulationRandom | None):
        super().__init__()
        self.population, self.random = population, random

    @torch.no_grad()
    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        mean = self.population.mean(tensordict["observation"])
        action = mean
        if self.random is not None:
            action = mean + self.population.log_std().exp() * self.random.normal(*mean.shape[1:])
        tensordict["action"] = action
        tensordict["action_mean"] = mean
        return tensordict
