"""Actor and critic of a population, as TensorDict modules that TorchRL's collectors, estimators and losses take."""

from __future__ import annotations

import math

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch.distributions import Independent, Normal
from torchrl.envs.utils import ExplorationType, exploration_type

from hts.rl.population import Parameters, Population
from hts.rl.random import PopulationRandom

LOG_2PI = math.log(2 * math.pi)


def log_prob(action: torch.Tensor, mean: torch.Tensor, log_std: torch.Tensor) -> torch.Tensor:
    """log N(action; mean, diag exp(2 log_std)), summed over actions; [..., A] -> [...]."""
    z = (action - mean) * torch.exp(-log_std)
    return -(0.5 * z.square() + log_std + 0.5 * LOG_2PI).sum(-1)


def _states(tensordict: TensorDictBase, key: str, count: int, size: int) -> torch.Tensor:
    """What tensordict has under key, [P, ..., size]. Raises ValueError for another shape: what broadcasts would be read
    by other candidates."""
    states = tensordict[key]
    if states.ndim < 3 or states.shape[0] != count or states.shape[-1] != size:
        raise ValueError(
            f"{key!r} has the shape {tuple(states.shape)}, expected ({count}, ..., {size}): the first dimension must "
            f"be the candidates, {count}, the last the {size} numbers of a state. Of a batch [P, N, T], flatten(1, 2) "
            "keeps the candidates in front."
        )
    return states


class PopulationActor(TensorDictModuleBase):
    """The policies of P candidates: observation [P, ..., O] -> loc, action [P, ..., A] and action_log_prob [P, ...].

    random: where the exploration noise comes from, a generator per candidate; None: the mean action, as under TorchRL's
    `set_exploration_type` of any type but random. `forward` is for collecting and gives no gradient; `get_dist` is for
    losses. Raises ValueError for a random with another number of generators than there are candidates; `forward` and
    `get_dist` for states of another shape.
    """

    in_keys = ["observation"]  # noqa: RUF012 - what TensorDictModuleBase asks for
    out_keys = ["loc", "action", "action_log_prob"]  # noqa: RUF012
    dist_sample_keys = ["action"]  # noqa: RUF012 - what TorchRL's losses ask for
    log_prob_keys = ["action_log_prob"]  # noqa: RUF012

    def __init__(self, population: Population, random: PopulationRandom | None = None) -> None:
        super().__init__()
        if random is not None and len(random.generators) != population.count:
            raise ValueError(
                f"random has {len(random.generators)} generators, expected one for each of the {population.count} "
                "candidates: PopulationRandom takes a seed for each."
            )
        self.population, self.random, self.members = population, random, slice(None)

    def of(self, members: slice) -> PopulationActor:
        """The policies of some candidates, with the same parameters and generators; for collecting."""
        part = PopulationActor(self.population)
        part.random, part.members = None if self.random is None else self.random.of(members), members
        return part

    @torch.no_grad()
    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        members = len(range(self.population.count)[self.members])
        observation = _states(tensordict, "observation", members, self.population.sizes.observation)
        loc, log_std = self.loc(observation), self.log_std(observation.ndim)
        action = loc
        if self.random is not None and exploration_type() in (None, ExplorationType.RANDOM):
            action = loc + log_std.exp() * self.random.normal(*loc.shape[1:])
        tensordict["loc"], tensordict["action"] = loc, action
        tensordict["action_log_prob"] = log_prob(action, loc, log_std)
        return tensordict

    def loc(self, observation: torch.Tensor) -> torch.Tensor:
        """Mean actions [P, ..., A], without gradients."""
        mean = self.population.mean(observation.flatten(1, -2), members=self.members)
        return mean.view(*observation.shape[:-1], -1)

    def log_std(self, ndim: int, named: Parameters | None = None) -> torch.Tensor:
        """ln sigma, [P, 1, ..., 1, A] of ndim dimensions."""
        log_std = self.population.log_std(named)[self.members]
        return log_std.view(len(log_std), *(1,) * (ndim - 2), -1)

    def get_dist(self, tensordict: TensorDictBase) -> Independent:
        """The policies' distribution in the states of tensordict [P, ...]; differentiable."""
        observation = _states(tensordict, "observation", self.population.count, self.population.sizes.observation)
        named = self.population.named()
        loc = self.population.mean(observation.flatten(1, -2), named).view(*observation.shape[:-1], -1)
        scale = self.log_std(observation.ndim, named).exp().expand_as(loc)
        return Independent(Normal(loc, scale, validate_args=False), 1, validate_args=False)


class PopulationCritic(TensorDictModuleBase):
    """The values of P candidates: critic_observation [P, ..., O_c] -> state_value [P, ..., 1]; differentiable.

    `forward` raises ValueError for states of another shape.
    """

    in_keys = ["critic_observation"]  # noqa: RUF012
    out_keys = ["state_value"]  # noqa: RUF012

    def __init__(self, population: Population) -> None:
        super().__init__()
        self.population = population

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        size = self.population.sizes.critic_observation
        observation = _states(tensordict, "critic_observation", self.population.count, size)
        value = self.population.value(observation.flatten(1, -2), self.population.named())
        tensordict["state_value"] = value.view(*observation.shape[:-1], 1)
        return tensordict
