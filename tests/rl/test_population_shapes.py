"""Candidates, bounds and prices of other shapes are refused, not read as something else."""

from __future__ import annotations

import math

import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModuleBase
from torch import nn

from hts.rl import (
    EqualityMultiplier,
    KLConstrainedPPOLoss,
    Population,
    PopulationActor,
    PopulationCritic,
    PopulationRandom,
    Sizes,
    UpperMultiplier,
    project_to_kl_bound,
)

SIZES = Sizes(3, 3, 1, (4,))


def test_a_weight_that_lies_the_other_way_round_is_not_read_as_another_one():
    candidate = Population(SIZES, 1).candidate(0)
    turned = {**candidate, "actor.0.weight": candidate["actor.0.weight"].t()}
    with pytest.raises(ValueError, match=r"candidate 1: 'actor.0.weight' is \(3, 4\), expected \(4, 3\)"):
        Population.from_candidates(SIZES, [candidate, turned])


def test_a_candidate_of_other_sizes_is_told_by_what_differs_or_is_missing():
    candidate = Population(SIZES, 1).candidate(0)
    with pytest.raises(ValueError, match=r"'actor.0.weight' is \(4, 3\), expected \(5, 3\), as Sizes\(observation=3"):
        Population.from_candidates(Sizes(3, 3, 1, (5,)), [candidate])
    with pytest.raises(ValueError, match=r"'log_std' is missing, expected \(1,\)"):
        Population.from_candidates(SIZES, [{name: value for name, value in candidate.items() if name != "log_std"}])


@pytest.mark.parametrize("bounds", [[0.1], [0.1, -1.0], [0.1, 0.0], [0.1, math.nan]])
def test_a_bound_that_cannot_be_shrinks_nobody(bounds):
    population = Population(SIZES, 2)
    anchor, before = population.frozen(), [vector.detach().clone() for vector in population.vectors]
    with pytest.raises(ValueError, match="expected a positive number for each of 2 candidates, infinity for no bound"):
        project_to_kl_bound(population, anchor, torch.randn(2, 5, 3), torch.tensor(bounds))
    assert all(torch.equal(vector, old) for vector, old in zip(population.vectors, before, strict=True))


@pytest.mark.parametrize("shape", [(2, 4, 5, 3), (10, 3), (3, 5, 3), (2, 5, 1)])
def test_states_of_another_shape_shrink_nobody(shape):
    population = Population(SIZES, 2)
    with pytest.raises(ValueError, match=r"observation has the shape .*, expected \(2, S, 3\).*flatten\(1, 2\)"):
        project_to_kl_bound(population, population.frozen(), torch.randn(shape), torch.ones(2))


def test_a_float_bound_holds_for_each_candidate():
    def shrunk(bounds) -> list[float]:
        population = Population(SIZES, 2)
        anchor = population.frozen()
        with torch.no_grad():
            for move, vector in enumerate(population.vectors, 1):
                vector[-1] += 0.4 * move  # log sigma
        return project_to_kl_bound(population, anchor, torch.zeros(2, 5, 3), bounds).tolist()

    assert shrunk(0.05) == shrunk(torch.tensor(0.05)) == shrunk(torch.tensor([0.05, 0.05]))
    assert shrunk(0.05)[1] < shrunk(0.05)[0] < 1.0
    with pytest.raises(ValueError, match=r"bounds are \[-1.0, -1.0\]; expected a positive number"):
        shrunk(-1.0)


class Named(TensorDictModuleBase):
    """An actor inside a module of somebody's own."""

    in_keys, out_keys = PopulationActor.in_keys, PopulationActor.out_keys

    def __init__(self, actor: PopulationActor) -> None:
        super().__init__()
        self.actor = actor

    def get_dist(self, tensordict):
        return self.actor.get_dist(tensordict)


def batch(*shape: int) -> TensorDict:
    """Samples of one candidate, seen by nobody yet."""
    alone = {"observation": torch.randn(*shape, 3), "critic_observation": torch.randn(*shape, 3)}
    numbers = {name: torch.zeros(*shape, 1) for name in ("advantage", "value_target", "state_value", "action")}
    return TensorDict({**alone, **numbers, "action_log_prob": torch.zeros(shape)}, shape)


@pytest.mark.parametrize(
    "made", [PopulationActor, PopulationCritic, lambda population: PopulationActor(population).get_dist]
)
@pytest.mark.parametrize("shape", [(16,), (4, 2), (3, 4), (1, 4)])
def test_states_without_the_candidates_in_front_are_told(made, shape):
    with pytest.raises(
        ValueError, match=r"observation' has the shape .*, expected \(2, ..., 3\): the first dimension must be the cand"
    ):
        made(Population(SIZES, 2))(batch(*shape))
    assert made(Population(SIZES, 2))(batch(2, 4)) is not None


@pytest.mark.parametrize("asked", ["forward", "kl_to_reference"])
@pytest.mark.parametrize("shape", [(16,), (4, 2), (3, 4)])
def test_a_loss_of_a_population_says_what_its_batch_begins_with(asked, shape):
    population = Population(SIZES, 2)
    loss = KLConstrainedPPOLoss(PopulationActor(population), PopulationCritic(population), kl_bound=torch.ones(2))
    ask = {"forward": loss, "kl_to_reference": loss.kl_to_reference}[asked]
    with pytest.raises(
        ValueError,
        match=r"batch has the shape .*, kl_bound \(2,\): its first dimension is to be the cand.*flatten\(1, 2\)",
    ):
        ask(batch(*shape))
    nameless = batch(*shape)
    nameless.batch_size = []
    with pytest.raises(ValueError, match="the first dimension must be the candidates, 2"):
        ask(nameless)


@pytest.mark.parametrize("bound", [0.05, torch.tensor(0.05), 1])
@pytest.mark.parametrize("inside", [False, True])
def test_a_float_is_the_bound_of_each_candidate_and_not_of_their_mean(bound, inside):
    population = Population(SIZES, 2)
    actor = PopulationActor(population)
    loss = KLConstrainedPPOLoss(Named(actor) if inside else actor, PopulationCritic(population), kl_bound=bound)
    with torch.no_grad():
        population.vectors[1][-1] += 1.0  # log sigma: (e^2 - 1) / 2 - 1 nats
    data = batch(2, 5)
    kl = loss.kl_to_reference(data)
    assert kl.tolist() == [0.0, pytest.approx((math.e**2 - 3.0) / 2.0)]
    loss.update_multiplier(kl)
    assert loss.multiplier.value[0] == 0.0 < loss.multiplier.value[1]
    assert loss(data).shape == (2,) and loss.kl_bound.tolist() == pytest.approx([float(bound)] * 2)


def test_a_float_of_one_candidate_stays_a_float_and_its_losses_scalars():
    population = Population(SIZES, 1)
    loss = KLConstrainedPPOLoss(PopulationActor(population), PopulationCritic(population), kl_bound=0.05)
    assert (loss.kl_bound.shape, loss.kl_to_reference(batch(1, 5)).shape, loss(batch(1, 5)).shape) == ((), (), ())
    loss = KLConstrainedPPOLoss(PopulationActor(population), PopulationCritic(population), kl_bound=torch.ones(1))
    assert loss(batch(1, 5)).shape == loss.kl_to_reference(batch(1, 5)).shape == (1,)


def test_bounds_and_a_reference_of_other_candidates_are_told_when_a_loss_is_made():
    population, three = Population(SIZES, 2), PopulationActor(Population(SIZES, 3))
    actor, critic = PopulationActor(population), PopulationCritic(population)
    with pytest.raises(
        ValueError, match=r"kl_bound has the shape \(3,\), actor_network 2 candidates; expected a bound"
    ):
        KLConstrainedPPOLoss(actor, critic, kl_bound=torch.ones(3))
    with pytest.raises(ValueError, match="reference has 3 candidates, actor_network 2; expected as many"):
        KLConstrainedPPOLoss(actor, critic, reference=three)


def test_a_critic_that_reads_no_tensordict_is_refused_with_what_makes_it_one():
    actor = PopulationActor(Population(SIZES, 2))
    with pytest.raises(
        TypeError, match=r"critic_network is a Linear, which reads no TensorDict.*ValueOperator\(critic"
    ):
        KLConstrainedPPOLoss(actor, nn.Linear(3, 1), kl_bound=torch.ones(2))


@pytest.mark.parametrize("made", [EqualityMultiplier, UpperMultiplier])
def test_one_price_is_not_made_a_price_for_each_instance(made):
    multiplier = made(0.1, 1)
    with pytest.raises(ValueError, match=r"mean has the shape \(5,\), expected \(1,\): one for each multiplier"):
        multiplier.update(torch.zeros(5))
    assert multiplier.update(torch.ones(1)).shape == (1,)


@pytest.mark.parametrize("made", [EqualityMultiplier, UpperMultiplier])
@pytest.mark.parametrize("number", [0.0, -1.0, math.inf, math.nan])
def test_a_scale_that_no_error_matters_against_is_refused(made, number):
    with pytest.raises(ValueError, match=f"is {number}; expected a positive number"):
        made(number)


@pytest.mark.parametrize("seeds", [[0], [0, 1, 2]])
def test_a_generator_for_each_candidate_is_asked_for_when_an_actor_is_made(seeds):
    population = Population(SIZES, 2)
    with pytest.raises(ValueError, match=f"random has {len(seeds)} generators, expected one for each of the 2 cand"):
        PopulationActor(population, PopulationRandom(seeds, torch.device("cpu")))
    part = PopulationActor(population, PopulationRandom([0, 1], torch.device("cpu"))).of(slice(1, 2))
    assert part.random is not None and len(part.random.generators) == 1
