"""One candidate of a population while it learns on a CPU: its parameters, its networks and the gradient of its loss."""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import Executor

import torch
from torch import Tensor

from hts.rl.mlp import MLP, Workspace
from hts.rl.population import Population
from hts.rl.settings import UpdateSettings
from hts.rl.surrogate_gradient import policy_gradient, value_gradient

NETWORKS = {"observation": "actor", "critic_observation": "critic"}
"""What each network reads."""


class Layout:
    """The order in which a candidate's parameters lie while it learns: a bias is its weight's last column,
    as in `MLP`."""

    def __init__(self, population: Population) -> None:
        self.layers = len(population.sizes.hidden) + 1
        self._shapes: dict[str, tuple[int, int]] = {}
        places = population.split(torch.arange(population.vectors[0].numel()))
        order = []
        for part in NETWORKS.values():
            for index in range(self.layers):
                name = f"{part}.{index}"
                weight = torch.cat((places[f"{name}.weight"], places[f"{name}.bias"].unsqueeze(1)), 1)
                self._shapes[name] = (weight.shape[0], weight.shape[1])
                order.append(weight.flatten())
        self._order = torch.cat((*order, places["log_std"]))

    def packed(self, vector: Tensor) -> Tensor:
        """A copy of a candidate's vector [D] in this order."""
        return vector.index_select(0, self._order)

    def unpacked(self, packed: Tensor) -> Tensor:
        """The other way round."""
        return torch.empty_like(packed).index_copy_(0, self._order, packed)

    def split(self, packed: Tensor) -> dict[str, Tensor]:
        """Views by name: "actor.0" [outputs, inputs + 1], ..., "critic.0", ..., "log_std" [J, 1]."""
        lengths = [rows * columns for rows, columns in self._shapes.values()]
        *parts, log_std = packed.split([*lengths, len(packed) - sum(lengths)])
        views = {name: part.view(shape) for (name, shape), part in zip(self._shapes.items(), parts, strict=True)}
        return views | {"log_std": log_std.unsqueeze(1)}


class Learner:
    """parameters [D], at first the candidate's, and their gradient [D], renewed by `differentiate`,
    in the layout's order."""

    def __init__(self, layout: Layout, parameters: Tensor) -> None:
        self.parameters, self.gradient = layout.packed(parameters), torch.empty_like(parameters)
        own, by_own = layout.split(self.parameters), layout.split(self.gradient)
        self._log_std, self._by_log_std = own["log_std"], by_own["log_std"]
        names = [[f"{part}.{index}" for index in range(layout.layers)] for part in NETWORKS.values()]
        self._actor, self._critic = (MLP([own[one] for one in part], [by_own[one] for one in part]) for part in names)
        self._widths = [len(own[name]) for name in names[0][:-1]]
        self._spaces: dict[tuple[str, int], Workspace] = {}

    def differentiate(
        self,
        batch: Mapping[str, Tensor],
        multiplier: float,
        policy_on: float,
        config: UpdateSettings,
        beside: Executor | None = None,
    ) -> dict[str, Tensor]:
        """The gradient of `population_loss` on a minibatch, as `columns` gives it. Returns parts of the loss, each [].

        beside: does the critic's part meanwhile, to the same bits. Without it the actor is done before the critic
        begins, in the same places: they stay in the cache.
        """
        samples = batch["observation"].shape[1]
        if beside is None:
            space = self._space("actor", samples)
            actor = self._actor_gradient(batch, multiplier, policy_on, config, space)
            return actor | self._critic_gradient(batch, config, space)
        critic = beside.submit(self._critic_gradient, batch, config, self._space("critic", samples))
        try:
            actor = self._actor_gradient(batch, multiplier, policy_on, config, self._space("actor", samples))
        finally:
            found = critic.result()  # whatever went wrong, nobody writes into the gradient any more
        return actor | found

    def _space(self, part: str, samples: int) -> Workspace:
        if (part, samples) not in self._spaces:
            self._spaces[part, samples] = Workspace(self._widths, samples, self.parameters)
        return self._spaces[part, samples]

    def _actor_gradient(
        self, batch: Mapping[str, Tensor], multiplier: float, policy_on: float, config: UpdateSettings, space: Workspace
    ) -> dict[str, Tensor]:
        x = batch["observation"]
        by_mean, by_log_std, policy, kl_old = policy_gradient(
            self._actor.forward(x, space),
            self._log_std,
            batch,
            multiplier,
            clip=config.clip,
            entropy_coef=config.entropy_coef,
            policy_on=policy_on,
        )
        self._by_log_std.copy_(by_log_std)
        self._actor.backward(x, by_mean, space)
        return {"policy": policy, "kl_old": kl_old}

    @torch.no_grad()
    def _critic_gradient(
        self, batch: Mapping[str, Tensor], config: UpdateSettings, space: Workspace
    ) -> dict[str, Tensor]:
        y = batch["critic_observation"]
        by_value, value = value_gradient(
            self._critic.forward(y, space)[0],
            batch["old_value"],
            batch["target"],
            clip=config.clip,
            value_coef=config.value_coef,
        )
        self._critic.backward(y, by_value.unsqueeze(0), space)
        return {"value": value}


class Columns:
    """A candidate's samples one above the other, so that a pass over them in another order is one copy.

    samples: name -> [S] or [S, size]; constant: name -> [1, J]. Below what a network reads comes a row of ones.
    """

    def __init__(self, samples: Mapping[str, Tensor], constant: Mapping[str, Tensor]) -> None:
        self._constant = {name: value.t() for name, value in constant.items()}
        parts = {name: value.t() if value.ndim == 2 else value.unsqueeze(0) for name, value in samples.items()}
        for name in NETWORKS:
            parts[name] = torch.cat((parts[name], parts[name].new_ones(1, parts[name].shape[1])))
        self._sizes = {name: len(part) for name, part in parts.items()}
        self._flat = [name for name, value in samples.items() if value.ndim == 1]
        self._table = torch.cat(list(parts.values()))

    def minibatches(self, order: Tensor, count: int) -> list[dict[str, Tensor]]:
        """The samples in order [S], in count parts: name -> [size, B] or [B]; constants [J, 1]."""
        found = []
        for part in self._table.index_select(1, order).chunk(count, 1):
            batch = dict(zip(self._sizes, part.split(list(self._sizes.values())), strict=True))
            found.append(batch | {name: batch[name][0] for name in self._flat} | self._constant)
        return found
