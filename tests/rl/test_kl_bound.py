"""The KL bound, its multiplier, and reward centring."""

from __future__ import annotations

import math

import pytest
import torch
from torch.distributions import Independent, Normal, kl_divergence

from hts.rl.actor import log_prob
from hts.rl.centring import RewardCentring
from hts.rl.kl import gaussian_kl
from hts.rl.kl_bound import mean_kl, project_to_kl_bound
from hts.rl.multiplier import EqualityMultiplier, LagrangeMultiplier
from hts.rl.population import Population, Sizes


def test_a_policy_has_zero_kl_to_itself():
    mean, log_std = torch.randn(5, 12), torch.randn(12)
    assert float(gaussian_kl(mean, log_std, mean, log_std).abs().max()) == 0.0


def test_a_shift_by_one_sigma_costs_half_a_nat_per_action():
    kl = gaussian_kl(
        torch.tensor([0.3, 0.3]), torch.tensor([0.3, 0.3]).log(), torch.zeros(2), torch.tensor([0.3, 0.3]).log()
    )
    assert float(kl) == pytest.approx(1.0)


def test_doubling_sigma_and_halving_it_cost_differently():
    zero, one, two = torch.zeros(1), torch.zeros(1), torch.full((1,), math.log(2.0))
    # KL(N(0, 2) || N(0, 1)) = (4 - 1) / 2 - ln 2; the other way round (1/4 - 1) / 2 + ln 2.
    assert float(gaussian_kl(zero, two, zero, one)) == pytest.approx(1.5 - math.log(2))
    assert float(gaussian_kl(zero, one, zero, two)) == pytest.approx(math.log(2) - 0.375)


@pytest.mark.parametrize("reverse", [False, True], ids=["policy first", "anchor first"])
def test_kl_agrees_with_torch_in_both_directions(reverse):
    generator = torch.Generator().manual_seed(1)
    mean, other = torch.randn(2, 7, 12, generator=generator)
    log_std, other_log_std = 0.5 * torch.randn(2, 12, generator=generator)
    if reverse:
        mean, other, log_std, other_log_std = other, mean, other_log_std, log_std
    p, q = (Independent(Normal(m, s.exp().expand_as(m)), 1) for m, s in ((mean, log_std), (other, other_log_std)))
    torch.testing.assert_close(gaussian_kl(mean, log_std, other, other_log_std), kl_divergence(p, q))


def test_log_probabilities_agree_with_torch():
    action, mean, log_std = torch.randn(6, 12), torch.randn(6, 12), 0.3 * torch.randn(12)
    expected = Independent(Normal(mean, log_std.exp().expand_as(mean)), 1).log_prob(action)
    torch.testing.assert_close(log_prob(action, mean, log_std), expected)


# ---------------------------------------------------------------------------------------------- multiplier


def test_the_multiplier_rises_above_the_bound_and_falls_below_it():
    multipliers = LagrangeMultiplier(torch.tensor([0.5, 0.5]), rate=0.1)
    multipliers.update(torch.tensor([1.0, 0.5]))  # twice the bound; on it
    torch.testing.assert_close(multipliers.value, torch.tensor([0.1, 0.0]))
    multipliers.update(torch.tensor([0.25, 0.75]))
    torch.testing.assert_close(multipliers.value, torch.tensor([0.05, 0.05]))


def test_the_multiplier_never_pulls_towards_leaving_the_anchor():
    multipliers = LagrangeMultiplier(torch.tensor([0.5]), rate=0.1)
    for _ in range(20):
        multipliers.update(torch.tensor([0.0]))
    assert float(multipliers.value) == 0.0


def test_one_wild_batch_raises_the_multiplier_by_a_limited_step():
    multipliers = LagrangeMultiplier(torch.tensor([0.5]), rate=0.1)
    multipliers.update(torch.tensor([1e9]))
    assert float(multipliers.value) == pytest.approx(0.2)


def test_without_a_bound_nothing_pulls():
    multipliers = LagrangeMultiplier(torch.tensor([math.inf, 0.5]), rate=0.1)
    for _ in range(50):
        multipliers.update(torch.tensor([1e6, 1.0]))
    assert multipliers.value[0] == 0.0 and multipliers.value[1] > 1.0


def test_bounds_are_approached_in_the_same_number_of_batches_whatever_their_size():
    multipliers = LagrangeMultiplier(torch.tensor([0.2, 1.0]), rate=0.05)
    multipliers.update(torch.tensor([0.3, 1.5]))
    assert multipliers.value[0] == pytest.approx(float(multipliers.value[1]))


@pytest.mark.parametrize("precision", [torch.float32, torch.float64])
def test_multipliers_go_on_from_a_saved_state(precision):
    """Also where what they are told of is in another precision than they are made in."""
    for make in (LagrangeMultiplier, EqualityMultiplier):
        multipliers, other = (make(0.7, rate=0.1) for _ in range(2))
        multipliers.update(torch.tensor(0.8, dtype=precision) / 3)
        multipliers.update(torch.tensor(1.0, dtype=precision) / 3 + 0.5)
        other.load_state_dict(multipliers.state_dict())
        for both in (multipliers, other):
            both.update(torch.tensor(1.1, dtype=precision) / 3 + 0.6)
        assert multipliers.value != 0.0 and torch.equal(other.value, multipliers.value)


# ------------------------------------------------------------------------------------- the end of training


def moved(distance: float = 0.5) -> tuple[Population, Population, torch.Tensor]:
    """Three candidates whose actions lie `distance` beside their anchor's in each of two actions, and what they saw."""
    anchor = Population(Sizes(3, 3, 2, (4,)), 3, init_std=1.0).frozen()
    population = Population.from_candidates(anchor.sizes, [anchor.candidate(index) for index in range(3)])
    with torch.no_grad():
        for vector in population.vectors:
            population.split(vector)["actor.1.bias"].add_(distance)
    population.refresh()
    return population, anchor, torch.randn(3, 20, 3)


def test_a_candidate_that_ended_beyond_its_bound_is_pulled_back_onto_it_and_no_other_moves():
    population, anchor, seen = moved()
    torch.testing.assert_close(mean_kl(population, anchor, seen), torch.full((3,), 0.25))  # 2 x 0.5^2 / 2
    before = [vector.detach().clone() for vector in population.vectors]
    scale = project_to_kl_bound(population, anchor, seen, torch.tensor([0.04, 0.3, math.inf]))
    # KL goes with the square of the distance: sqrt(0.04 / 0.25) = 0.4.
    assert scale[0] == pytest.approx(0.4, abs=1e-3) and scale[1:].tolist() == [1.0, 1.0]
    kl = mean_kl(population, anchor, seen)
    assert 0.039 < kl[0] <= 0.04
    assert torch.equal(population.vectors[1], before[1]) and torch.equal(population.vectors[2], before[2])


@pytest.mark.parametrize("what", ["weights", "an observation", "infinite weights"])
def test_a_candidate_whose_kl_is_not_a_number_is_not_called_inside(what):
    population, anchor, seen = moved()
    with torch.no_grad():
        if what == "an observation":
            seen[1, 0] = math.nan
        else:
            population.vectors[1].fill_(math.nan if what == "weights" else math.inf)
    population.refresh()
    before = [vector.detach().clone() for vector in population.vectors]
    with pytest.raises(ValueError, match=r"candidates \[1\] cannot be held to their bounds"):
        project_to_kl_bound(population, anchor, seen, torch.tensor([0.04, 0.04, math.inf]))
    for now, then in zip(population.vectors, before, strict=True):
        assert torch.equal(now.nan_to_num(7.0), then.nan_to_num(7.0))
    project_to_kl_bound(population, anchor, seen, torch.tensor([0.04, math.inf, math.inf]))  # it is not held to one
    assert 0.039 < mean_kl(population, anchor, seen)[0] <= 0.04


# ------------------------------------------------------------------------------------------------ centring


def test_the_first_batch_sets_the_centre_to_its_own_mean():
    centre = RewardCentring(0.05, 2)
    centre.update(torch.tensor([[1.0, 3.0], [-5.0, -7.0]]))
    torch.testing.assert_close(centre.mean, torch.tensor([2.0, -6.0]))  # beta / o = 1, not 0.05


def test_the_centre_follows_the_unbiased_formula():
    centre = RewardCentring(0.5, 1)
    # o: 0.5, 0.75, 0.875; beta: 1, 2/3, 4/7. Means of 1, 4, 0: 1, then 1 + 2/3 x 3 = 3, then 3 - 4/7 x 3.
    for reward, mean in ((1.0, 1.0), (4.0, 3.0), (0.0, 3.0 - 12.0 / 7.0)):
        centre.update(torch.full((1, 8), reward))
        assert float(centre.mean) == pytest.approx(mean, rel=1e-6)


def test_a_rate_of_nothing_centres_nothing():
    centre = RewardCentring(0.0)
    centre.update(torch.ones(1, 8))
    assert torch.equal(centre(torch.ones(1, 8)), torch.ones(1, 8))
    for rate in (-0.1, 1.5, math.nan):
        with pytest.raises(ValueError, match="expected 0"):
            RewardCentring(rate)


def test_a_constant_added_to_the_measured_reward_moves_the_centre_by_it():
    rewards = torch.randn(5, 1, 64, generator=torch.Generator().manual_seed(2))
    plain, shifted = RewardCentring(0.2, 1), RewardCentring(0.2, 1)
    for reward in rewards:
        plain.update(reward)
        shifted.update(reward + 7.0)
    torch.testing.assert_close(shifted.mean - plain.mean, torch.tensor([7.0]), atol=1e-5, rtol=0)


def test_one_candidates_centre_does_not_depend_on_the_others():
    rewards = torch.randn(3, 4, 32, generator=torch.Generator().manual_seed(3))
    crowd, alone = RewardCentring(0.1, 4), RewardCentring(0.1, 1)
    for reward in rewards:
        crowd.update(reward)
        alone.update(reward[2:3])
    assert torch.equal(crowd.mean[2:3], alone.mean)


@pytest.mark.parametrize("precision", [torch.float32, torch.float64])
def test_centres_go_on_from_a_saved_state(precision):
    centre, other = RewardCentring(0.1, 1), RewardCentring(0.1, 1)
    centre.update(torch.ones(1, 4, dtype=precision) / 3)
    other.load_state_dict(centre.state_dict())
    for both in (centre, other):
        both.update(torch.zeros(1, 4, dtype=precision))
    assert torch.equal(centre.mean, other.mean)
