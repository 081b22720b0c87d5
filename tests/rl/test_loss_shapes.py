"""What does not fit each other is told in one line where torch would broadcast it, or speak of dimensions."""

from __future__ import annotations

import re

import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torch import nn
from torch.distributions import Independent, Normal
from torchrl.modules import IndependentNormal, NormalParamExtractor, ProbabilisticActor, ValueOperator

from hts.rl import (
    KLConstrainedPPOLoss,
    LagrangeMultiplier,
    MeasuredReward,
    Population,
    PopulationActor,
    PopulationCritic,
    PopulationRandom,
    RewardCentring,
    Sizes,
    distribution_kl,
)
from hts.rl.loss_checks import check_action

COUNT, ACTIONS = 8, 2


def actor_of(actions: int = ACTIONS, distribution=IndependentNormal) -> ProbabilisticActor:
    head = nn.Sequential(nn.Linear(3, 2 * actions), NormalParamExtractor())
    module = TensorDictModule(head, ["observation"], ["loc", "scale"])
    return ProbabilisticActor(module, in_keys=["loc", "scale"], distribution_class=distribution, return_log_prob=True)


def loss_and_batch(**how) -> tuple[KLConstrainedPPOLoss, TensorDict]:
    torch.manual_seed(0)
    actor = actor_of(how.pop("actions", ACTIONS), how.pop("distribution", IndependentNormal))
    critic = nn.Linear(3, 1)
    loss = KLConstrainedPPOLoss(actor, ValueOperator(critic, in_keys=["observation"]), **how)
    data = TensorDict({"observation": torch.randn(COUNT, 3)}, [COUNT])
    with torch.no_grad():
        loss.critic_network(actor(data))
    data["advantage"], data["value_target"] = torch.randn(COUNT, 1), torch.randn(COUNT, 1)
    return loss, data


def test_numbers_of_actions_may_have_a_dimension_of_one_behind_them_or_none():
    loss, data = loss_and_batch()
    expected = loss(data)
    other = data.clone()
    other["action_log_prob"] = data["action_log_prob"].unsqueeze(-1)
    for key in ("advantage", "value_target", "state_value"):
        other[key] = data[key].squeeze(-1)
    found = loss(other)
    assert all(torch.equal(found[key], expected[key]) for key in loss.out_keys)


@pytest.mark.parametrize("key", ["advantage", "value_target", "state_value", "action_log_prob"])
def test_two_numbers_for_an_action_are_told_by_their_key(key):
    loss, data = loss_and_batch()
    data[key] = torch.zeros(COUNT, 2)
    with pytest.raises(ValueError, match=rf"^'{key}' has the shape \(8, 2\), the actor's log-probabilities \(8,\)"):
        loss(data)


@pytest.mark.parametrize(
    ("actions", "shape"), [(2, (8, 1)), (2, (8, 3)), (2, (8,)), (2, (8, 2, 1)), (1, (8,)), (1, (8, 2))]
)
def test_an_action_of_another_width_is_told_though_it_would_broadcast(actions, shape):
    loss, data = loss_and_batch(actions=actions)
    data["action"] = torch.zeros(shape)
    said = rf"^'action' has the shape {re.escape(str(shape))}, expected \(8, {actions}\): in states \(8,\) the policy"
    with pytest.raises(ValueError, match=said):
        loss(data)


def test_so_is_one_of_candidates():
    population = Population(Sizes(3, 3, 2, (4,)), 2)
    loss = KLConstrainedPPOLoss(PopulationActor(population), PopulationCritic(population))
    states = {name: torch.randn(2, 5, 3) for name in ("observation", "critic_observation")}
    numbers = {name: torch.zeros(2, 5, 1) for name in ("advantage", "value_target", "state_value", "action")}
    data = TensorDict({**states, **numbers, "action_log_prob": torch.zeros(2, 5)}, [2, 5])
    with pytest.raises(ValueError, match=r"^'action' has the shape \(2, 5, 1\), expected \(2, 5, 2\)"):
        loss(data)


def test_actions_of_a_policy_that_looks_at_no_state_are_many():
    loss, data = loss_and_batch()
    head = loss.actor_network[0].module[0]
    with torch.no_grad():
        head.weight.zero_()  # it does the same everywhere, and its distribution may say so once
    expected = loss(data)
    dist = loss.actor_network.get_dist(data[:1])
    check_action(data["action"], dist, "action")
    torch.testing.assert_close(
        dist.log_prob(data["action"]), loss.actor_network.get_dist(data).log_prob(data["action"])
    )
    assert torch.isfinite(expected["loss_objective"])


def test_a_distribution_of_single_components_is_told_what_it_lacks():
    loss, data = loss_and_batch(distribution=Normal)
    with pytest.raises(ValueError, match=r"log-probabilities \(8, 2\).*by torch's Independent"):
        loss(data)


@pytest.mark.parametrize(
    ("lacks", "gives"),
    [
        ("action", "A collector"),
        ("action_log_prob", "An actor with return_log_prob=True"),
        ("advantage", "GAE"),
        ("value_target", "GAE"),
    ],
)
def test_what_a_batch_lacks_is_said_with_who_gives_it(lacks, gives):
    loss, data = loss_and_batch()
    with pytest.raises(KeyError, match=rf"has no '{lacks}'; it has .*\. {gives} gives it"):
        loss(data.exclude(lacks))


def test_so_is_what_the_networks_read_and_it_lacks():
    loss, data = loss_and_batch()
    said = "^.The batch has no 'observation', which actor_network reads; it has .*'action', .*A collector gives it"
    for ask in (loss, loss.kl_to_reference):
        with pytest.raises(KeyError, match=said):
            ask(data.exclude("observation"))
    loss.critic_network = ValueOperator(nn.Linear(3, 1), in_keys=["seen"])
    with pytest.raises(KeyError, match="has no 'seen', which critic_network reads"):
        loss(data)


def test_a_batch_without_its_candidates_in_front_is_told():
    loss, data = loss_and_batch(kl_bound=torch.tensor([0.1, 0.2]))
    for ask in (loss, loss.kl_to_reference):
        with pytest.raises(
            ValueError, match=r"shape \(8,\), kl_bound \(2,\): its first dimension is to be the candidates"
        ):
            ask(data)
        nameless = data.clone()
        nameless.batch_size = []
        with pytest.raises(ValueError, match=r"shape \(8,\), kl_bound \(2,\)"):
            ask(nameless)
    assert loss(data.reshape(2, COUNT // 2)).shape == (2,)


def test_one_bound_in_a_list_is_no_bound_of_every_sample():
    loss, data = loss_and_batch(kl_bound=torch.tensor([0.1]))
    with pytest.raises(ValueError, match="Give a float as kl_bound where there is one policy"):
        loss(data)


def test_a_reference_of_other_actions_is_no_reference():
    actor, critic = actor_of(), ValueOperator(nn.Linear(3, 1), in_keys=["observation"])
    _, data = loss_and_batch()
    with pytest.raises(
        ValueError, match=r"policy is of actions \(2,\) in states \(8,\), its reference of actions \(1,\)"
    ):
        KLConstrainedPPOLoss(actor, critic, reference=actor_of(1))(data)
    with pytest.raises(ValueError, match=r"its reference of actions \(\) in states \(8, 2\)"):
        KLConstrainedPPOLoss(actor, critic, reference=actor_of(distribution=Normal)).kl_to_reference(data)


def test_a_reference_that_does_not_look_at_states_is_one():
    def normal(*shape: int) -> Independent:
        return Independent(Normal(torch.zeros(*shape, ACTIONS), torch.ones(*shape, ACTIONS)), 1)

    assert distribution_kl(normal(COUNT), normal()).tolist() == [0.0] * COUNT
    assert distribution_kl(normal(COUNT), normal(1)).tolist() == [0.0] * COUNT
    with pytest.raises(ValueError, match=r"in states \(8,\), its reference .* in states \(4,\)"):
        distribution_kl(normal(COUNT), normal(4))
    with pytest.raises(ValueError, match=r"in states \(\), its reference .* in states \(8,\)"):
        distribution_kl(normal(), normal(COUNT))


@pytest.mark.parametrize(
    ("how", "said"),
    [
        ({"clip_epsilon": -0.2}, "clip_epsilon is -0.2; expected a positive number"),
        ({"clip_epsilon": float("nan")}, "clip_epsilon is nan"),
        ({"multiplier_rate": float("nan")}, "rate is nan; expected a number from 0 on"),
        ({"multiplier_rate": -1.0}, "rate is -1.0"),
        ({"kl_bound": torch.ones(2, 1)}, r"kl_bound has the shape \(2, 1\); expected a float, or \[P\]"),
    ],
)
def test_settings_that_cannot_be_are_refused(how, said):
    with pytest.raises(ValueError, match=said):
        loss_and_batch(**how)


def test_a_multiplier_that_stands_still_is_a_setting():
    still = LagrangeMultiplier(0.5, rate=0.0)
    assert float(still.update(torch.tensor(5.0))) == 0.0


def test_a_centre_for_one_candidate_is_not_made_one_for_each_instance():
    centring = RewardCentring(0.1, count=1)
    with pytest.raises(
        ValueError, match=r"reward has the shape \(5, 1\), expected one that begins with the candidates"
    ):
        centring.update(torch.ones(5, 1))
    assert centring.mean.shape == (1,)
    measured = MeasuredReward(torch.tensor([1.0]), 0.1, in_key="effort")
    step = TensorDict({"effort": torch.ones(5, 1), "reward": torch.zeros(5, 1)}, [5])
    with pytest.raises(ValueError, match="With one weight for all, give a float"):
        measured(TensorDict({"next": step}, [5]))


@pytest.mark.parametrize(
    ("how", "said"),
    [
        ({"weight": float("nan"), "dt": 0.1}, "weight is nan; expected a finite number"),
        ({"weight": torch.ones(2, 1), "dt": 0.1}, r"or \[P\] for P candidates"),
        ({"weight": 1.0, "dt": 0.0}, "dt is 0.0; expected the length of a control step, s"),
    ],
)
def test_a_measured_reward_of_no_number_is_refused(how, said):
    with pytest.raises(ValueError, match=said):
        MeasuredReward(**how, in_key="effort")


@pytest.mark.parametrize(("count", "found"), [(None, "1 mean;"), (3, "3 means;")])
def test_candidates_are_not_centred_by_one_mean_of_all_of_them(count, found):
    with pytest.raises(ValueError, match=rf"weight is of 2 candidates, centring has {found}.*\(0.05, count=2\)"):
        MeasuredReward(torch.ones(2), 0.1, in_key="effort", centring=RewardCentring(0.05, count))
    step = TensorDict({"effort": torch.tensor([[[-2.0]], [[-0.3]]]), "reward": torch.zeros(2, 1, 1)}, [2, 1])
    for weight, centring, expected in (
        (torch.ones(2), RewardCentring(0.05, 2), [0.0, 0.0]),  # what the message says
        (torch.ones(2), RewardCentring(0.0), [-0.2, -0.03]),  # centres nothing
        (1.0, RewardCentring(0.05, 2), [0.0, 0.0]),  # one weight for all
    ):
        measured = MeasuredReward(weight, 0.1, in_key="effort", centring=centring)
        found = measured(TensorDict({"next": step.clone()}, [2, 1]))["next", "reward"].flatten()
        torch.testing.assert_close(found, torch.tensor(expected))


@pytest.mark.parametrize("candidates", [1, 3])
def test_weights_of_other_candidates_than_the_batch_has_are_told_without_centring_too(candidates):
    measured = MeasuredReward(torch.ones(2), 0.1, in_key="effort", centring=RewardCentring(0.0))
    step = TensorDict({"effort": torch.zeros(candidates, 4, 1), "reward": torch.zeros(candidates, 4, 1)}, [candidates])
    said = rf"^The measured reward has the shape \({candidates}, 4, 1\), weight is of 2 candidates"
    with pytest.raises(ValueError, match=said):
        measured(TensorDict({"next": step}, [candidates]))


def test_a_batch_without_what_its_steps_ended_in_is_told():
    with pytest.raises(KeyError, match="The batch has no 'next', where its rewards are; it has 'effort'"):
        MeasuredReward(1.0, 0.1, in_key="effort")(TensorDict({"effort": torch.zeros(3, 1)}, [3]))


def test_random_numbers_of_other_candidates_are_not_gone_on_from():
    two, three = (PopulationRandom(range(count), torch.device("cpu")) for count in (2, 3))
    with pytest.raises(ValueError, match="of 2 candidates, expected those of 3: they are of another training"):
        three.load_state_dict(two.state_dict())


def test_without_an_entropy_bonus_no_entropy_is_sampled():
    class Counted(IndependentNormal):
        asked = 0

        def entropy(self):
            Counted.asked += 1
            raise NotImplementedError

    loss, data = loss_and_batch(distribution=Counted)
    state = torch.get_rng_state()
    assert float(loss(data)["loss_entropy"]) == 0.0
    assert Counted.asked == 0 and torch.equal(state, torch.get_rng_state())
    loss, data = loss_and_batch(distribution=Counted, entropy_coeff=0.1)
    assert float(loss(data)["loss_entropy"].detach()) != 0.0 and Counted.asked == 1
