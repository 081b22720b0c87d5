"""Numbers, batches, references and saved states of another kind or size are one line of ours, not several of torch."""

from __future__ import annotations

import math
import re

import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from test_loss_shapes import loss_and_batch
from torch import nn
from torchrl.modules import IndependentNormal, NormalParamExtractor, ProbabilisticActor, ValueOperator

from hts.rl import (
    EqualityMultiplier,
    KLConstrainedPPOLoss,
    LagrangeMultiplier,
    MeasuredReward,
    Population,
    PopulationActor,
    PopulationCritic,
    RewardCentring,
    Sizes,
    UpperMultiplier,
    project_to_kl_bound,
)


def actor_of(size: int) -> ProbabilisticActor:
    head = nn.Sequential(nn.Linear(size, 4), NormalParamExtractor())
    module = TensorDictModule(head, ["observation"], ["loc", "scale"])
    return ProbabilisticActor(
        module, in_keys=["loc", "scale"], distribution_class=IndependentNormal, return_log_prob=True
    )


def critic_of(size: int) -> ValueOperator:
    return ValueOperator(nn.Linear(size, 1), in_keys=["observation"])


def population_of(size: int, count: int = 2, actions: int = 2) -> Population:
    return Population(Sizes(size, size, actions, (4,)), count)


def measured(**how) -> MeasuredReward:
    return MeasuredReward(**{"weight": 1.0, "dt": 0.1, "in_key": "effort", **how})


@pytest.mark.parametrize("given", ["0.2", None, [0.2]])
@pytest.mark.parametrize(
    ("name", "make"),
    [
        ("dt", lambda given: measured(dt=given)),
        ("rate", lambda given: RewardCentring(given)),
        ("rate", lambda given: LagrangeMultiplier(0.5, given)),
        ("scale", lambda given: EqualityMultiplier(given)),
        ("limit", lambda given: UpperMultiplier(given)),
        ("clip_epsilon", lambda given: loss_and_batch(clip_epsilon=given)),
        ("critic_coeff", lambda given: loss_and_batch(critic_coeff=given)),
        ("entropy_coeff", lambda given: loss_and_batch(entropy_coeff=given)),
        ("clip_value", lambda given: loss_and_batch(clip_value=given or "0.2")),
        ("rate", lambda given: loss_and_batch(multiplier_rate=given)),
    ],
)
def test_what_is_no_number_is_told_with_what_it_is(name, make, given):
    with pytest.raises(TypeError, match=rf"^{name} is .*, a \w+; expected a number: ") as caught:
        make(given)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("given", ["0.2", None])
def test_so_is_a_weight_or_a_bound_that_may_be_of_each_candidate(given):
    with pytest.raises(TypeError, match=rf"^weight is {given!r}; expected a finite number, or \[P\] for P candidates"):
        measured(weight=given)
    population = population_of(3)
    with pytest.raises(TypeError, match=rf"^bounds is {given!r}; expected a number, or \[P\] for P candidates"):
        project_to_kl_bound(population, population.frozen(), torch.zeros(2, 4, 3), given)


def test_a_number_may_be_a_tensor():
    assert float(measured(dt=torch.tensor(0.1)).dt) == pytest.approx(0.1)


@pytest.mark.parametrize("several", [False, True])
def test_an_empty_batch_is_told(several):
    loss, data = loss_and_batch(kl_bound=torch.tensor([0.1, 0.2]) if several else 0.5)
    empty = data.reshape(2, -1)[:, :0] if several else data[:0]
    for ask in (loss, loss.kl_to_reference):
        with pytest.raises(
            ValueError, match=rf"^The batch has the shape {re.escape(str(tuple(empty.shape)))}, nothing"
        ):
            ask(empty)


def test_nothing_has_no_centre():
    reward = measured()
    nothing = TensorDict({"effort": torch.zeros(0, 1), "reward": torch.zeros(0, 1)}, [0])
    with pytest.raises(ValueError, match=r"^The batch has the shape \(0,\), nothing is in it"):
        reward(TensorDict({"next": nothing}, [0]))
    with pytest.raises(ValueError, match=r"^The reward has the shape \(0, 1\), nothing is in it"):
        reward.centring.update(torch.zeros(0, 1))
    assert float(reward.centring.mean) == 0.0  # it was NaN for good
    population = population_of(3)
    with pytest.raises(ValueError, match=r"^observation has the shape \(2, 0, 3\), no state is in it"):
        project_to_kl_bound(population, population.frozen(), torch.zeros(2, 0, 3), 0.5)


@pytest.mark.parametrize("which", ["actor_network", "critic_network", "reference"])
def test_a_network_of_another_size_than_the_batch_is_named(which):
    sizes = {"actor_network": 3, "critic_network": 3, "reference": 3} | {which: 5}
    actor, critic = actor_of(sizes["actor_network"]), critic_of(sizes["critic_network"])
    loss = KLConstrainedPPOLoss(actor, critic, reference=actor_of(sizes["reference"]))
    _, data = loss_and_batch()
    for ask in (loss,) if which == "critic_network" else (loss, loss.kl_to_reference):
        with pytest.raises(
            ValueError, match=rf"^{which} cannot read the batch, where it finds 'observation' \(8, 3\): "
        ):
            ask(data)


def test_what_a_network_says_of_the_machine_is_passed_on():
    class Full(nn.Module):
        def forward(self, observation):
            raise torch.OutOfMemoryError("no room")

    _, data = loss_and_batch()
    loss = KLConstrainedPPOLoss(actor_of(3), ValueOperator(Full(), in_keys=["observation"]))
    with pytest.raises(torch.OutOfMemoryError, match="no room"):
        loss(data)


def test_a_populations_reference_of_other_sizes_is_told_before_any_batch():
    population = population_of(3)
    actor, critic = PopulationActor(population), PopulationCritic(population)
    with pytest.raises(
        ValueError, match="^reference reads 5 numbers of a state and has 2 actions, actor_network reads 3"
    ):
        KLConstrainedPPOLoss(actor, critic, reference=PopulationActor(population_of(5)))
    for other in (population_of(5), population_of(3, count=3), population_of(3, actions=1)):
        with pytest.raises(ValueError, match="^reference is . candidates of Sizes.*; expected the same of both"):
            project_to_kl_bound(population, other, torch.zeros(2, 4, 3), 0.5)


@pytest.mark.parametrize(
    ("mine", "other"),
    [
        (lambda: population_of(3), lambda: population_of(5)),
        (lambda: population_of(3), lambda: population_of(3, count=3)),
        (lambda: PopulationActor(population_of(3)), lambda: PopulationActor(population_of(5))),
        (lambda: LagrangeMultiplier(torch.ones(2)), lambda: LagrangeMultiplier(torch.ones(3))),
        (lambda: LagrangeMultiplier(1.0), lambda: LagrangeMultiplier(torch.ones(3))),  # torch took the first
        (lambda: EqualityMultiplier(0.1, 2), lambda: EqualityMultiplier(0.1, 3)),
        (lambda: RewardCentring(0.1, 2), lambda: RewardCentring(0.1, 3)),
        (lambda: measured(weight=torch.ones(2)), lambda: measured(weight=torch.ones(3))),
        (
            lambda: KLConstrainedPPOLoss(actor_of(3), critic_of(3)),
            lambda: KLConstrainedPPOLoss(actor_of(5), critic_of(3)),
        ),
        (
            lambda: KLConstrainedPPOLoss(actor_of(3), critic_of(3), kl_bound=torch.ones(2)),
            lambda: KLConstrainedPPOLoss(actor_of(3), critic_of(3)),
        ),
    ],
)
def test_a_saved_state_of_other_sizes_is_one_line_and_its_own_is_taken(mine, other):
    module = mine()
    with pytest.raises(ValueError, match=r"^\w+: '[\w.]+' of the saved state has the shape .*, expected \(") as caught:
        module.load_state_dict(other().state_dict())
    assert "\n" not in str(caught.value)
    saved = mine().state_dict()
    module.load_state_dict(saved)
    assert all(torch.equal(value, module.state_dict()[name]) for name, value in saved.items())


def test_a_candidate_without_its_normaliser_is_told():
    whole = population_of(3).candidate(0)
    lacking = {name: value for name, value in whole.items() if name != "observation_std"}
    with pytest.raises(ValueError, match=r"^candidate 0: 'observation_std' is missing, expected \(3,\)"):
        Population.from_candidates(Sizes(3, 3, 2, (4,)), [lacking])


def test_settings_that_are_numbers_stay_what_they_were():
    loss, data = loss_and_batch(clip_value=None, entropy_coeff=1, critic_coeff=True)
    assert math.isfinite(float(loss(data)["loss_objective"].detach()))
