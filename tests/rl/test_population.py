"""Stacked actor-critics: what one candidate is, alone and among others."""

from __future__ import annotations

import copy
import threading

import pytest
import torch
from tensordict import TensorDict
from torch.nn import functional as F
from torchrl.envs import ExplorationType, set_exploration_type

from hts.rl.actor import PopulationActor
from hts.rl.backend import CpuBackend
from hts.rl.kl_bound import project_to_kl_bound
from hts.rl.population import Population, Sizes
from hts.rl.random import PopulationRandom
from hts.rl.rows import row_mean, row_standardised

SIZES = Sizes(5, 7, 2, (8, 4))


def test_parameters_have_the_shapes_of_their_layers():
    assert SIZES.shapes() == {
        "actor.0.weight": (8, 5),
        "actor.0.bias": (8,),
        "actor.1.weight": (4, 8),
        "actor.1.bias": (4,),
        "actor.2.weight": (2, 4),
        "actor.2.bias": (2,),
        "critic.0.weight": (8, 7),
        "critic.0.bias": (8,),
        "critic.1.weight": (4, 8),
        "critic.1.bias": (4,),
        "critic.2.weight": (1, 4),
        "critic.2.bias": (1,),
        "log_std": (2,),
    }


def test_the_mean_action_is_the_network_written_out():
    population = Population(SIZES, 2, seed=3)
    population.observation_mean += 0.5
    population.observation_std *= 2.0
    x = torch.randn(2, 6, 5)
    for index in range(2):
        one = population.candidate(index)
        h = (x[index] - 0.5) / 2.0
        h = F.elu(h @ one["actor.0.weight"].T + one["actor.0.bias"])
        h = F.elu(h @ one["actor.1.weight"].T + one["actor.1.bias"])
        expected = h @ one["actor.2.weight"].T + one["actor.2.bias"]
        torch.testing.assert_close(population.mean(x)[index], expected)


def test_normalised_observations_are_clipped_at_ten():
    population = Population(SIZES, 1)
    assert population.normalised("observation", torch.tensor([[[-99.0, 99.0, 3.0, 0.0, 10.5]]])).tolist() == [
        [[-10.0, 10.0, 3.0, 0.0, 10.0]]
    ]


def test_a_new_policy_barely_moves_and_explores_with_the_sigma_asked_for():
    population = Population(SIZES, 1, init_std=0.5)
    assert population.mean(torch.randn(1, 100, 5)).abs().max() < 0.1
    torch.testing.assert_close(population.log_std().exp(), torch.full((1, 1, 2), 0.5))


def test_a_candidate_computes_the_same_bits_alone_and_in_a_crowd():
    crowd = Population(SIZES, 4, seed=1)
    alone = Population.from_candidates(SIZES, [crowd.candidate(2)])
    x, y = torch.randn(4, 33, 5), torch.randn(4, 33, 7)
    assert torch.equal(crowd.mean(x)[2:3], alone.mean(x[2:3]))
    assert torch.equal(crowd.value(y)[2:3], alone.value(y[2:3]))


@pytest.mark.parametrize("samples", [512, 777, 3072])  # halves of 256 and 256, 384 and 393, 1536 and 1536
def test_halves_side_by_side_compute_what_the_whole_does(samples):
    crowd = Population(SIZES, 3, seed=1)
    alone = Population.from_candidates(SIZES, [crowd.candidate(2)])
    x, y = torch.randn(3, samples, 5), torch.randn(3, samples, 7)
    with torch.no_grad():  # as samples are prepared; with gradients nothing is halved
        means, values = crowd.mean(x), crowd.value(y)
        assert torch.equal(means[2:3], alone.mean(x[2:3])) and torch.equal(values[2:3], alone.value(y[2:3]))
    torch.testing.assert_close(means, crowd.mean(x), atol=1e-6, rtol=1e-5)
    torch.testing.assert_close(values, crowd.value(y), atol=1e-6, rtol=1e-5)


def test_many_samples_of_one_candidate_are_computed_in_halves_by_threads():
    noted = []

    class Noting(Population):
        def _one(self, part, x, one):
            noted.append((len(x), threading.current_thread() is threading.main_thread()))
            return super()._one(part, x, one)

    with torch.no_grad():
        Noting(SIZES, 1).mean(torch.randn(1, 1000, 5))
    assert sorted(noted) == [(448, False), (552, False)]  # 7 x 64 and the rest


def test_stacked_parameters_compute_what_single_ones_do():
    population = Population(SIZES, 3, seed=1)
    stacked = population.split(torch.stack(list(population.vectors)))
    x = torch.randn(3, 9, 5)
    torch.testing.assert_close(population.mean(x, stacked), population.mean(x))
    torch.testing.assert_close(population.log_std(stacked), population.log_std())


def test_the_normaliser_holds_mean_and_standard_deviation_of_all_it_was_shown():
    population = Population(SIZES, 2)
    data = 3.0 + 2.0 * torch.randn(2, 400, 5, generator=torch.Generator().manual_seed(0))
    for part in data.split(100, dim=1):
        population.update_normaliser("observation", part)
    torch.testing.assert_close(population.observation_mean[:, 0], data.mean(1))
    torch.testing.assert_close(population.observation_std[:, 0], data.std(1, unbiased=False), rtol=1e-4, atol=1e-4)
    assert population.observation_count.tolist() == [400.0, 400.0]


def test_a_normaliser_that_has_seen_very_much_still_follows_what_it_is_shown():
    population = Population(Sizes(1, 1, 1, (2,)), 1)
    population.observation_count.fill_(1e8)
    for _ in range(2):
        population.update_normaliser("observation", torch.full((1, 100, 1), 1e6))
    # 100 in 100,000,100 samples are a millionth, of 1e6 so 1 each time: the count stays 1e8, however many come.
    assert population.observation_count.tolist() == [1e8]
    assert float(population.observation_mean) == pytest.approx(2.0, rel=1e-4)


def test_an_anchor_stays_while_its_population_moves():
    population = Population(SIZES, 2)
    anchor, x = population.frozen(), torch.randn(2, 3, 5)
    before = anchor.mean(x).clone()
    with torch.no_grad():
        population.vectors[0].add_(1.0)
        population.observation_mean += 1.0
    population.refresh()
    assert torch.equal(anchor.mean(x), before) and not torch.equal(population.mean(x), before)
    assert not any(parameter.requires_grad for parameter in anchor.parameters())


def test_an_anchor_is_as_precise_as_its_population():
    population = Population(SIZES, 2).double()
    anchor, x = population.frozen(), torch.randn(2, 3, 5, dtype=torch.float64)
    assert torch.equal(anchor.mean(x), population.mean(x))
    with torch.no_grad():
        population.split(population.vectors[1])["actor.2.bias"].add_(1.0)
    scale = project_to_kl_bound(population, anchor, x, 0.1)
    assert scale[0] == 1.0 and 0.0 < scale[1] < 1.0


def test_candidates_survive_the_way_out_and_in():
    population = Population(SIZES, 3, seed=5)
    population.update_normaliser("critic_observation", torch.randn(3, 50, 7))
    again = Population.from_candidates(SIZES, [population.candidate(index) for index in range(3)])
    for index in range(3):
        one, two = population.candidate(index), again.candidate(index)
        assert one.keys() == two.keys() and all(torch.equal(one[name], two[name]) for name in one)
        assert not any(value.requires_grad for value in one.values())


def test_a_candidates_random_numbers_depend_on_its_seed_alone():
    crowd, alone = (PopulationRandom(seeds, torch.device("cpu")) for seeds in ([4, 9, 5], [9]))
    for draw in ("uniform", "normal"):
        assert torch.equal(getattr(crowd, draw)(6)[1:2], getattr(alone, draw)(6)), draw
    order = CpuBackend().permutation
    assert torch.equal(order(crowd, 6)[1:2], order(alone, 6))
    assert not torch.equal(crowd.uniform(6)[0], crowd.uniform(6)[1])


def test_random_numbers_go_on_from_a_saved_state():
    random = PopulationRandom([1, 2], torch.device("cpu"))
    random.normal(100)
    saved, expected = random.state_dict(), random.normal(7)
    random.load_state_dict(saved)
    assert torch.equal(random.normal(7), expected)


@pytest.mark.parametrize("reduce", [row_mean, row_standardised])
def test_reductions_give_a_row_the_same_bits_among_any_others(reduce):
    x = torch.randn(7, 1001)
    for index in range(7):
        assert torch.equal(reduce(x)[index], reduce(x[index : index + 1])[0])


def test_standardised_rows_have_mean_zero_and_deviation_one():
    rows = row_standardised(torch.tensor([[1.0, 2.0, 3.0], [10.0, 20.0, 60.0]]))
    torch.testing.assert_close(rows[0], torch.tensor([-1.0, 0.0, 1.0]))
    torch.testing.assert_close(rows.mean(1), torch.zeros(2), atol=1e-6, rtol=0)


def test_what_acts_follows_every_change_of_the_parameters():
    population, x = Population(SIZES, 2, seed=3), torch.randn(2, 6, 5)
    before = population.mean(x)
    kept = population._ready()
    population.refresh()
    assert population._ready() is kept  # nothing has changed
    with torch.no_grad():
        population.vectors[1].mul_(2.0)
    after = population.mean(x)
    assert torch.equal(after[0], before[0]) and not torch.equal(after[1], before[1])
    torch.testing.assert_close(population.double().mean(x.double()), after.double())


def test_a_copy_acts_with_its_own_parameters():
    population, x = Population(SIZES, 1, seed=3), torch.randn(1, 6, 5)
    begun, before = copy.deepcopy(population.state_dict()), population.mean(x).clone()
    with torch.no_grad():
        population.vectors[0].add_(0.5)
    moved = population.mean(x)  # as many changes as the copy counts below
    copied = copy.deepcopy(population)
    assert torch.equal(copied.mean(x), moved)
    again = copy.deepcopy(population)
    again.load_state_dict(begun)
    assert torch.equal(again.mean(x), before) and torch.equal(population.mean(x), moved)


def test_what_acts_is_a_copy_of_every_parameter():
    population = Population(SIZES, 1, seed=3)
    population.refresh()
    memory = population.vectors[0].untyped_storage().data_ptr()
    assert all(one.untyped_storage().data_ptr() != memory for one in population._ready()[0].values())


@pytest.mark.parametrize("kind", [ExplorationType.DETERMINISTIC, ExplorationType.MEAN, ExplorationType.MODE])
def test_an_actor_explores_unless_it_is_told_otherwise(kind):
    random = PopulationRandom([1, 2], torch.device("cpu"))
    actor = PopulationActor(Population(SIZES, 2, seed=3), random)
    seen, before = TensorDict({"observation": torch.randn(2, 6, 5)}, [2, 6]), random.state_dict()
    with set_exploration_type(kind):
        found = actor(seen.copy())
    assert torch.equal(found["action"], found["loc"])
    assert torch.equal(random.state_dict()["generators"], before["generators"])  # nothing was drawn
    with set_exploration_type(ExplorationType.RANDOM):
        assert not (actor(seen.copy())["action"] == found["loc"]).any()
    assert not (actor(seen.copy())["action"] == found["loc"]).any()
