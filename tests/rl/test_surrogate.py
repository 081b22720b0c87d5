"""The mathematics of the loss against arithmetic on paper."""

from __future__ import annotations

import math

import pytest
import torch

from hts.rl.actor import log_prob
from hts.rl.population import Population, Sizes
from hts.rl.surrogate import population_loss


def identity(count: int = 1) -> Population:
    """One observation, one action: mean action and value both equal the observation while it is positive; sigma 1."""
    population = Population(Sizes(1, 1, 1, (1,)), count)
    with torch.no_grad():
        for vector in population.vectors:
            for name, value in population.split(vector).items():
                value.fill_(1.0 if name.endswith("weight") else 0.0)
    population.refresh()
    return population


def batch(anchor: bool = True) -> dict[str, torch.Tensor]:
    """Two samples with probability ratios 1.5 and 0.5 and advantages 1 and -1."""
    observation = torch.tensor([[[1.0], [2.0]]])
    action = torch.tensor([[[1.0], [2.5]]])
    now = log_prob(action, observation, torch.zeros(1))
    made = {
        "observation": observation,
        "critic_observation": observation,
        "action": action,
        "old_mean": observation,
        "old_log_std": torch.zeros(1, 1, 1),
        "log_prob": now - torch.tensor([[1.5, 0.5]]).log(),
        "advantage": torch.tensor([[1.0, -1.0]]),
        "target": torch.tensor([[2.0, 1.5]]),
        "old_value": torch.tensor([[0.5, 2.0]]),
    }
    if anchor:
        made |= {"reference_mean": observation - 1.0, "reference_log_std": torch.zeros(1, 1, 1)}
    return made


def loss(population=None, anchor=True, **changes):
    settings = {"clip": 0.2, "value_coef": 1.0, "entropy_coef": 0.0, **changes}
    return population_loss(population or identity(), batch(anchor), torch.tensor([0.4]), **settings)


def test_the_surrogate_is_clipped_where_the_ratio_went_too_far():
    # min(1.5, 1.2) = 1.2 and min(-0.5, -0.8) = -0.8: minus their mean.
    assert float(loss().policy) == pytest.approx(-0.2)


def test_the_value_loss_takes_the_worse_of_clipped_and_unclipped():
    # V 1, was 0.5, target 2: max(1, (0.7 - 2)^2 = 1.69). V 2, was 2, target 1.5: 0.25.
    assert float(loss().value) == pytest.approx((1.69 + 0.25) / 2)


def test_the_total_adds_the_kl_to_the_anchor_times_its_multiplier():
    parts = loss()
    assert float(parts.kl_reference) == pytest.approx(0.5)  # one sigma away
    assert float(parts.total.detach()) == pytest.approx(-0.2 + 0.97 + 0.4 * 0.5)


def test_the_kl_to_the_anchor_is_seen_from_the_policy_being_trained():
    wide = batch() | {"reference_log_std": torch.full((1, 1, 1), math.log(2.0))}
    parts = population_loss(identity(), wide, torch.ones(1), clip=0.2, value_coef=1.0, entropy_coef=0.0)
    # KL(N(o, 1) || N(o - 1, 2)) = ln 2 + (1 + 1) / 8 - 1/2; the other way round it would be 1.31.
    assert float(parts.kl_reference) == pytest.approx(math.log(2) - 0.25)


def test_without_an_anchor_the_multiplier_has_no_say():
    parts = loss(anchor=False)
    assert float(parts.kl_reference) == 0.0 and float(parts.total.detach()) == pytest.approx(0.77)


def test_entropy_grows_with_sigma_and_is_subtracted():
    population = identity()
    with torch.no_grad():
        population.split(population.vectors[0])["log_std"].fill_(0.3)
    parts, without = loss(population, entropy_coef=0.1), loss(population)
    entropy = 0.3 + 0.5 * math.log(2 * math.pi * math.e)  # of a normal distribution: ln sigma + ln(2 pi e) / 2
    assert float(parts.entropy) == pytest.approx(entropy)
    assert float(parts.total.detach() - without.total.detach()) == pytest.approx(-0.1 * entropy, abs=1e-6)


def test_the_kl_to_the_old_policy_is_seen_from_the_old_policy():
    population = identity()
    with torch.no_grad():
        population.split(population.vectors[0])["log_std"].fill_(math.log(2.0))
    assert float(loss(population).kl_old) == pytest.approx(math.log(2) - 0.375, abs=1e-6)


def test_while_only_the_critic_learns_the_actor_does_not_move():
    population = identity()
    parts = population_loss(
        population, batch(), torch.zeros(1), clip=0.2, value_coef=1.0, entropy_coef=0.1, policy_on=0.0
    )
    parts.total.sum().backward()
    gradient = population.split(population.vectors[0].grad)
    for name, value in gradient.items():
        assert bool(value.any()) == name.startswith("critic"), name


def test_no_gradient_crosses_from_one_candidate_to_another():
    population = identity(2)
    double = {name: value.expand(2, *value.shape[1:]).clone() for name, value in batch().items()}
    double["advantage"][1] *= float("nan")
    parts = population_loss(population, double, torch.tensor([0.4, 0.4]), clip=0.2, value_coef=1.0, entropy_coef=0.0)
    parts.total.sum().backward()
    alone = identity()
    loss(alone).total.sum().backward()
    assert torch.equal(population.vectors[0].grad, alone.vectors[0].grad)
    assert not torch.isfinite(population.vectors[1].grad).all()
