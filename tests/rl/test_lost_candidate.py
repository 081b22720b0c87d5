"""A candidate whose numbers are no numbers stops a training, and may be left out of it."""

from __future__ import annotations

import math

import pytest
import torch
from tensordict import TensorDict

from hts.rl import KLConstrainedPPOLoss, Population, PopulationActor, PopulationCritic, PopulationRandom, Sizes

SIZES, COUNT = Sizes(3, 3, 1, (4,)), 3


def batch_of(actor: PopulationActor, critic: PopulationCritic, seed: int) -> TensorDict:
    draw = torch.Generator().manual_seed(seed)
    states = {name: torch.randn(COUNT, 20, 3, generator=draw) for name in ("observation", "critic_observation")}
    data = TensorDict(states, [COUNT, 20])
    with torch.no_grad():
        critic(actor(data))
    for key in ("advantage", "value_target"):
        data[key] = torch.randn(COUNT, 20, 1, generator=draw)
    return data


def trained(lost: int | None) -> Population:
    """Three batches; the lost candidate's advantages are no numbers from the second on."""
    population = Population(SIZES, COUNT)
    reference = population.frozen()
    actor = PopulationActor(population, PopulationRandom(range(COUNT), torch.device("cpu")))
    critic = PopulationCritic(population)
    loss = KLConstrainedPPOLoss(actor, critic, kl_bound=1e-4)
    optimiser = torch.optim.Adam(loss.parameters(), lr=1e-2)
    for batch in range(3):
        data = batch_of(actor, critic, batch)
        if lost is not None and batch > 0:
            data["advantage"][lost, 5] = math.nan
        for _ in range(2):
            parts = loss(data)
            optimiser.zero_grad()
            (parts["loss_objective"] + parts["loss_critic"]).sum().backward()
            optimiser.step()
        if batch == 1 and lost is not None:
            with pytest.raises(ValueError, match="kl is .*nan.*Stop training"):
                loss.update_multiplier(loss.kl_to_reference(data))
        for index in loss.kl_to_reference(data).isnan().nonzero().flatten().tolist():
            vector = population.vectors[index].requires_grad_(False)
            vector.copy_(reference.vectors[index])
            vector.grad = None
        assert loss.update_multiplier(loss.kl_to_reference(data)).isfinite().all()
    if lost is not None:
        assert torch.equal(population.vectors[lost], reference.vectors[lost])
        assert float(loss.kl_to_reference(data)[lost]) == 0.0
    return population


def test_the_others_go_on_without_a_candidate_that_is_lost():
    alone, beside = trained(None), trained(1)
    for index in (0, 2):
        assert torch.equal(beside.vectors[index], alone.vectors[index])
