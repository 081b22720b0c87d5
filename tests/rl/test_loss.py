"""The loss module beside TorchRL's `ClipPPOLoss`, and what its bound adds."""

from __future__ import annotations

import math

import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import CompositeDistribution, ProbabilisticTensorDictSequential, TensorDictModule
from torch import nn
from torchrl.modules import IndependentNormal, MaskedCategorical, ProbabilisticActor, ValueOperator
from torchrl.objectives import ClipPPOLoss
from torchrl.objectives.value import GAE

from hts.rl import (
    KLConstrainedPPOLoss,
    MeasuredReward,
    Population,
    PopulationActor,
    PopulationCritic,
    Sizes,
)
from hts.rl.surrogate import population_loss


class Head(nn.Module):
    """A mean and a sigma that does not depend on the state."""

    def __init__(self, sizes=(3, 8, 2)):
        super().__init__()
        self.net = nn.Sequential(nn.Linear(sizes[0], sizes[1]), nn.Tanh(), nn.Linear(sizes[1], sizes[2]))
        self.log_std = nn.Parameter(torch.full((sizes[2],), -0.3))

    def forward(self, observation):
        loc = self.net(observation)
        return loc, self.log_std.exp().expand_as(loc)


def networks(distribution=IndependentNormal, seed=0):
    torch.manual_seed(seed)
    head = TensorDictModule(Head(), in_keys=["observation"], out_keys=["loc", "scale"])
    actor = ProbabilisticActor(head, in_keys=["loc", "scale"], distribution_class=distribution, return_log_prob=True)
    critic = ValueOperator(nn.Sequential(nn.Linear(3, 8), nn.Tanh(), nn.Linear(8, 1)), in_keys=["observation"])
    return actor, critic


@torch.no_grad()
def batch_of(actor, critic, count=64, seed=1) -> TensorDict:
    """Samples of a policy that has since moved, with advantages large enough to be clipped on both sides."""
    generator = torch.Generator().manual_seed(seed)
    data = TensorDict({"observation": torch.randn(count, 3, generator=generator)}, [count])
    torch.manual_seed(seed)
    critic(actor(data))
    data["action_log_prob"] += 0.4 * torch.randn(count, generator=generator)
    data["state_value"] += 0.4 * torch.randn(count, 1, generator=generator)
    data["advantage"] = torch.randn(count, 1, generator=generator)
    data["value_target"] = data["state_value"] + data["advantage"]
    return data


def gradients(losses: TensorDict, *modules: nn.Module) -> list[torch.Tensor]:
    total = losses["loss_objective"] + losses["loss_critic"] + losses["loss_entropy"]
    parameters = [parameter for module in modules for parameter in module.parameters()]
    return list(torch.autograd.grad(total.sum(), parameters))


# -------------------------------------------------------------------------------------------- beside ClipPPOLoss


@pytest.mark.parametrize("clip_value", [None, 0.2])
@pytest.mark.parametrize("normalise", [False, True])
def test_without_a_bound_it_is_clip_ppo_loss(clip_value, normalise):
    actor, critic = networks()
    data = batch_of(actor, critic)
    ours = KLConstrainedPPOLoss(
        actor,
        critic,
        kl_bound=math.inf,
        clip_epsilon=0.2,
        critic_coeff=0.7,
        entropy_coeff=0.01,
        clip_value=clip_value,
        normalize_advantage=normalise,
    )
    found = ours(data)
    slopes = gradients(found, actor, critic)
    stock = ClipPPOLoss(
        actor,
        critic,
        clip_epsilon=0.2,
        critic_coeff=0.7,
        entropy_coeff=0.01,
        clip_value=clip_value,
        loss_critic_type="l2",
        normalize_advantage=normalise,
    )
    expected = stock(data)
    for name in ("loss_objective", "loss_critic", "loss_entropy", "kl_approx", "clip_fraction"):
        torch.testing.assert_close(found[name], expected[name], msg=name)
    assert 0.1 < float(found["clip_fraction"]) < 0.9  # both sides of the clip are compared
    theirs = torch.autograd.grad(
        sum(expected[name] for name in ("loss_objective", "loss_critic", "loss_entropy")),
        [*stock.actor_network_params.parameters(), *stock.critic_network_params.parameters()],
    )
    for one, other in zip(sorted(slopes, key=torch.sum), sorted(theirs, key=torch.sum), strict=True):
        torch.testing.assert_close(one, other)


@pytest.mark.parametrize("shape", [(), (1,)])
def test_a_minibatch_of_one_sample_is_clip_ppo_loss_too(shape):
    """64 samples in minibatches of 7 leave one over; its deviation is that of nothing."""
    actor, critic = networks()
    data = batch_of(actor, critic)[0].reshape(shape)
    same = {"clip_epsilon": 0.2, "entropy_coeff": 0.01, "normalize_advantage": True, "clip_value": 0.2}
    ours = KLConstrainedPPOLoss(actor, critic, kl_bound=math.inf, **same)
    found, expected = ours(data), ClipPPOLoss(actor, critic, loss_critic_type="l2", **same)(data)
    for name in ("loss_objective", "loss_critic", "loss_entropy"):
        torch.testing.assert_close(found[name], expected[name], msg=name)
    assert all(bool(slope.isfinite().all()) for slope in gradients(found, actor, critic))


def test_one_sample_of_each_candidate_is_taken_as_it_is():
    population = Population(Sizes(3, 3, 2, (8,)), 3, seed=3)
    actor, critic = PopulationActor(population), PopulationCritic(population)
    data, bounds = population_batch(population, count=1), torch.full((3,), math.inf)
    plain, normalised = (
        KLConstrainedPPOLoss(actor, critic, kl_bound=bounds, normalize_advantage=one)(data)["loss_objective"]
        for one in (False, True)
    )
    assert normalised.isfinite().all() and torch.equal(plain, normalised)


def test_a_population_of_one_is_the_same_loss():
    population = Population(Sizes(3, 3, 2, (8,)), 1, seed=3)
    actor, critic = PopulationActor(population), PopulationCritic(population)
    data = population_batch(population)
    ours = KLConstrainedPPOLoss(actor, critic, kl_bound=torch.tensor([math.inf]), clip_value=None, entropy_coeff=0.02)
    stock = ClipPPOLoss(actor, critic, loss_critic_type="l2", entropy_coeff=0.02)
    found, expected = ours(data), stock(data)
    for name in ("loss_objective", "loss_critic", "loss_entropy"):
        assert found[name].shape == (1,)
        torch.testing.assert_close(found[name][0], expected[name], msg=name)


@torch.no_grad()
def population_batch(population: Population, count=40, seed=2) -> TensorDict:
    """Samples [P, B] as a collector and GAE would leave them."""
    generator = torch.Generator().manual_seed(seed)
    size, shape = population.sizes, (population.count, count)
    data = TensorDict(
        {
            "observation": torch.randn(*shape, size.observation, generator=generator),
            "critic_observation": torch.randn(*shape, size.critic_observation, generator=generator),
        },
        shape,
    )
    PopulationCritic(population)(PopulationActor(population)(data))
    data["action"] = data["loc"] + torch.randn(data["loc"].shape, generator=generator)
    data["action_log_prob"] = -2.0 + 0.3 * torch.randn(*shape, generator=generator)
    data["advantage"] = torch.randn(*shape, 1, generator=generator)
    data["value_target"] = data["state_value"] + data["advantage"]
    return data


# ------------------------------------------------------------------------------------------------- the bound


def test_the_kl_is_added_times_the_multiplier_and_forward_changes_nothing():
    actor, critic = networks()
    data = batch_of(actor, critic)
    loss = KLConstrainedPPOLoss(actor, critic, reference=networks(seed=5)[0], kl_bound=0.1, multiplier_rate=0.05)
    before = loss(data)
    assert float(before["kl"]) > 0.0
    assert float(loss.update_multiplier(torch.tensor(0.2))) == pytest.approx(0.05)  # 0.05 x (0.2 / 0.1 - 1)
    state = {name: value.clone() for name, value in loss.state_dict().items()}
    after = loss(data)
    torch.testing.assert_close(after["loss_objective"], before["loss_objective"] + 0.05 * before["kl"])
    assert all(torch.equal(loss.state_dict()[name], value) for name, value in state.items())


def test_the_reference_is_frozen_and_no_optimiser_sees_it():
    actor, critic = networks()
    loss = KLConstrainedPPOLoss(actor, critic, kl_bound=0.5)
    assert {id(p) for p in loss.parameters()} == {id(p) for p in (*actor.parameters(), *critic.parameters())}
    data = batch_of(actor, critic)
    assert float(loss.kl_to_reference(data)) == pytest.approx(0.0, abs=1e-6)
    with torch.no_grad():
        for parameter in actor.parameters():
            parameter.add_(0.3)
    assert float(loss.kl_to_reference(data)) > 0.1
    again = KLConstrainedPPOLoss(*networks(seed=9), kl_bound=0.5)
    again.load_state_dict(loss.state_dict())  # the reference is saved with it
    assert float(again.kl_to_reference(data)) == pytest.approx(float(loss.kl_to_reference(data)))


def test_the_reference_neither_drops_out_nor_follows_its_batches_whatever_the_loss_is_told():
    torch.manual_seed(0)
    head = nn.Sequential(nn.BatchNorm1d(3), nn.Dropout(0.5), Head())
    actor = ProbabilisticActor(
        TensorDictModule(head, in_keys=["observation"], out_keys=["loc", "scale"]),
        in_keys=["loc", "scale"],
        distribution_class=IndependentNormal,
        return_log_prob=True,
    )
    actor.eval()
    critic = networks()[1]
    data = batch_of(actor, critic)
    loss = KLConstrainedPPOLoss(actor, critic)
    held = nn.ModuleList([loss])
    held.eval()
    held.train()
    assert actor.training and not any(module.training for module in loss.reference.modules())
    actor.eval()
    before = {name: value.clone() for name, value in loss.reference.state_dict().items()}
    assert float(loss.kl_to_reference(data)) == pytest.approx(0.0, abs=1e-6)
    assert all(torch.equal(loss.reference.state_dict()[name], value) for name, value in before.items())


def test_a_trained_population_is_the_reference_of_the_next_loss():
    population = Population(Sizes(3, 3, 2, (8,)), 2, seed=3)
    actor, critic = PopulationActor(population), PopulationCritic(population)
    data = population_batch(population)
    optimiser = torch.optim.Adam(population.parameters(), lr=1e-2)
    losses = KLConstrainedPPOLoss(actor, critic, kl_bound=torch.ones(2))(data)
    (losses["loss_objective"] + losses["loss_critic"]).sum().backward()
    optimiser.step()
    again = KLConstrainedPPOLoss(actor, critic, kl_bound=torch.ones(2))
    assert again.kl_to_reference(data).abs().max() < 1e-6


def test_the_fast_path_is_the_same_mathematics():
    population = Population(Sizes(3, 4, 2, (8,)), 3, seed=3)
    reference = Population.from_candidates(population.sizes, [Population(population.sizes, 1, 0.7, 8).candidate(0)] * 3)
    data = population_batch(population)
    loss = KLConstrainedPPOLoss(
        PopulationActor(population),
        PopulationCritic(population),
        reference=PopulationActor(reference),
        kl_bound=torch.tensor([0.1, 0.5, math.inf]),
        critic_coeff=0.8,
        entropy_coeff=0.01,
    )
    loss.update_multiplier(torch.tensor([0.4, 0.6, 5.0]))
    assert loss.multiplier.value.tolist() == pytest.approx([0.1, 0.01, 0.0])
    found = loss(data)
    slopes = gradients(found, population)
    batch = {
        "observation": data["observation"],
        "critic_observation": data["critic_observation"],
        "action": data["action"],
        "log_prob": data["action_log_prob"],
        "advantage": data["advantage"].squeeze(-1),
        "target": data["value_target"].squeeze(-1),
        "old_value": data["state_value"].squeeze(-1),
        "old_mean": data["loc"],
        "old_log_std": population.log_std(),
        "reference_mean": reference.mean(data["observation"]),
        "reference_log_std": reference.log_std(),
    }
    parts = population_loss(population, batch, loss.multiplier.value, clip=0.2, value_coef=0.8, entropy_coef=0.01)
    torch.testing.assert_close(parts.kl_reference, found["kl"])
    total = found["loss_objective"] + found["loss_critic"] + found["loss_entropy"]
    torch.testing.assert_close(parts.total, total)
    expected = torch.autograd.grad(parts.total.sum(), list(population.parameters()))
    for one, other in zip(slopes, expected, strict=True):
        torch.testing.assert_close(one, other)


def test_candidates_do_not_see_each_other():
    population = Population(Sizes(3, 3, 2, (8,)), 2, seed=3)
    data = population_batch(population)
    data["advantage"][1] = float("nan")
    loss = KLConstrainedPPOLoss(PopulationActor(population), PopulationCritic(population), kl_bound=torch.ones(2))
    first, second = gradients(loss(data), population)
    assert torch.isfinite(first).all() and not torch.isfinite(second).all()


def test_what_a_batch_lacks_is_named():
    actor, critic = networks()
    loss = KLConstrainedPPOLoss(actor, critic)
    with pytest.raises(KeyError, match=r"no 'advantage'; it has .*GAE gives it"):
        loss(batch_of(actor, critic).exclude("advantage"))
    with pytest.raises(KeyError, match="'state_value' of the old critic, which clip_value needs"):
        loss(batch_of(actor, critic).exclude("state_value"))
    with pytest.raises(ValueError, match=r"kl_bound is -1.0; expected positive numbers"):
        KLConstrainedPPOLoss(actor, critic, kl_bound=-1.0)


def test_an_actor_of_which_no_single_distribution_can_be_asked_is_refused():
    actor, critic = networks()
    with pytest.raises(TypeError, match="actor_network is a Linear without get_dist; expected a ProbabilisticActor"):
        KLConstrainedPPOLoss(torch.nn.Linear(2, 2), critic)
    kinds = {"turn": torch.distributions.Normal, "walk": torch.distributions.Normal}
    maps = {"distribution_map": kinds, "log_prob_key": "action_log_prob"}
    several = ProbabilisticActor(
        actor[0],
        in_keys=["loc", "scale"],
        out_keys=["turn", "walk"],
        distribution_class=CompositeDistribution,
        distribution_kwargs=maps,
    )
    for one in (several, ProbabilisticTensorDictSequential(actor[0], several[-1])):
        with pytest.raises(TypeError, match="several actions"):
            KLConstrainedPPOLoss(one, critic)


def test_a_batch_that_carries_gradients_is_refused_since_nothing_would_be_learned_from_it():
    actor, critic = networks()
    loss, data = KLConstrainedPPOLoss(actor, critic), batch_of(actor, critic)
    with torch.enable_grad():
        data["action_log_prob"] = actor(data.copy())["action_log_prob"]
    with pytest.raises(ValueError, match=r"'action_log_prob' carries gradients.*torch.no_grad"):
        loss(data)
    loss(data.detach())


@pytest.mark.parametrize("bound", [float("inf"), 0.1])
def test_a_policy_whose_actions_are_masked_has_the_gradients_of_clip_ppo(bound):
    torch.manual_seed(0)
    head = TensorDictModule(nn.Linear(3, 4), in_keys=["observation"], out_keys=["logits"])
    actor = ProbabilisticActor(
        head, in_keys=["logits", "mask"], distribution_class=MaskedCategorical, return_log_prob=True
    )
    critic = networks()[1]
    data = TensorDict({"observation": torch.randn(64, 3), "mask": torch.ones(64, 4, dtype=torch.bool)}, [64])
    data["mask"][:, 2] = False
    with torch.no_grad():
        critic(actor(data))
    data["advantage"], data["value_target"] = torch.randn(64, 1), torch.randn(64, 1)
    constrained = KLConstrainedPPOLoss(actor, critic, kl_bound=bound, entropy_coeff=0.0)
    found = constrained(data)
    assert found["kl"] == pytest.approx(0.0, abs=1e-6)
    own = torch.autograd.grad(found["loss_objective"], list(actor.parameters()))
    stock = ClipPPOLoss(actor, critic, entropy_bonus=False, normalize_advantage=constrained.normalize_advantage)
    theirs = torch.autograd.grad(stock(data)["loss_objective"], list(actor.parameters()))
    for one, other in zip(own, theirs, strict=True):
        torch.testing.assert_close(one, other)


def test_without_a_bound_a_reference_that_forbids_an_action_changes_no_gradient():
    torch.manual_seed(0)
    head, critic = nn.Linear(3, 3), networks()[1]

    def masked(*allowed: bool) -> ProbabilisticActor:
        logits = TensorDictModule(
            lambda observation: (head(observation), torch.tensor(allowed).expand(len(observation), 3)),
            in_keys=["observation"],
            out_keys=["logits", "mask"],
        )
        return ProbabilisticActor(
            logits, in_keys=["logits", "mask"], distribution_class=MaskedCategorical, return_log_prob=True
        )

    actor, data = masked(True, True, True), TensorDict({"observation": torch.randn(64, 3)}, [64])
    with torch.no_grad():
        critic(actor(data))
    data["advantage"], data["value_target"] = torch.randn(64, 1), torch.randn(64, 1)
    slopes = []
    for reference in (actor, masked(True, True, False)):
        found = KLConstrainedPPOLoss(actor, critic, reference=reference, kl_bound=float("inf"))(data)
        slopes.append(torch.autograd.grad(found["loss_objective"], list(head.parameters())))
    assert found["kl"] == float("inf") and torch.isfinite(found["loss_objective"])
    assert all(torch.equal(one, other) for one, other in zip(*slopes, strict=True))


def test_keys_can_be_renamed_and_stock_gae_fills_them():
    actor, critic = networks()
    loss = KLConstrainedPPOLoss(actor, critic)
    loss.set_keys(advantage="adv", value_target="goal")
    assert {"adv", "goal", "observation", "action", "action_log_prob", "state_value"} == set(loss.in_keys)
    data = batch_of(actor, critic).exclude("advantage", "value_target", "state_value").view(8, 8)
    flags = {name: torch.zeros(8, 8, 1, dtype=torch.bool) for name in ("done", "terminated")}
    data["next"] = TensorDict({"observation": data["observation"], "reward": torch.ones(8, 8, 1), **flags}, [8, 8])
    loss.make_value_estimator(gamma=0.9, lmbda=0.8)
    assert isinstance(loss.value_estimator, GAE)
    loss.value_estimator(data)
    assert torch.isfinite(loss(data.flatten())["loss_objective"])


@pytest.mark.parametrize("keys", [{"in_key": "nope"}, {"in_key": "heat", "reward_key": "nope"}])
def test_a_measured_reward_names_the_entry_that_is_not_there(keys):
    step = {"reward": torch.zeros(4, 1), "heat": torch.ones(4, 1)}
    data = TensorDict({"next": TensorDict(step, [4])}, [4])
    with pytest.raises(KeyError, match=r"is 'nope', which no step has; it has 'heat', 'reward'|'reward', 'heat'"):
        MeasuredReward(1.0, 0.02, **keys)(data)


def test_a_measured_reward_of_another_shape_than_the_reward_is_refused_though_it_would_broadcast():
    steps = {"power": torch.ones(8, 8), "reward": torch.zeros(8, 8, 1)}
    data = TensorDict({"next": TensorDict(steps, [8, 8])}, [8, 8])
    with pytest.raises(ValueError, match=r"in_key 'power' has the shape \(8, 8\), the reward \(8, 8, 1\)"):
        MeasuredReward(1.0, 0.02, in_key="power")(data)
