"""One batch of several agents beside TorchRL's `ClipPPOLoss`: what they share, and what is each agent's own."""

from __future__ import annotations

import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torch import nn
from torch.distributions import Categorical
from torchrl.modules import IndependentNormal, NormalParamExtractor, ProbabilisticActor, ValueOperator
from torchrl.objectives import ClipPPOLoss

from hts.rl import KLConstrainedPPOLoss

STATES, AGENTS = 8, 3
LOSSES = ("loss_objective", "loss_critic", "loss_entropy")


def loss_and_batch(distribution=IndependentNormal, values: str = "shared", **how):
    """A policy of three agents; the state is worth something to all of them, or to each something else."""
    torch.manual_seed(0)
    keys = ["logits"] if distribution is Categorical else ["loc", "scale"]
    head = nn.Linear(3, 4) if distribution is Categorical else nn.Sequential(nn.Linear(3, 4), NormalParamExtractor())
    module = TensorDictModule(head, [("agents", "observation")], [("agents", key) for key in keys])
    actor = ProbabilisticActor(
        module,
        in_keys={key: ("agents", key) for key in keys},
        out_keys=[("agents", "action")],
        distribution_class=distribution,
        return_log_prob=True,
    )
    critic = ValueOperator(nn.Linear(3, 1), in_keys=["state" if values == "shared" else ("agents", "observation")])
    data = TensorDict({"state": torch.randn(STATES, 3), "agents": {"observation": torch.randn(STATES, AGENTS, 3)}})
    data.batch_size = [STATES]
    with torch.no_grad():
        critic(actor(data))
    data["agents", "action_log_prob"] += 0.3 * torch.randn(STATES, AGENTS)
    data["value_target"] = torch.randn_like(data["state_value"])
    data["advantage"] = torch.randn(STATES, 1)
    return KLConstrainedPPOLoss(actor, critic, entropy_coeff=0.01, **how), data


@pytest.mark.parametrize("distribution", [IndependentNormal, Categorical])
@pytest.mark.parametrize("values", ["shared", "each"])
@pytest.mark.parametrize("how", [{}, {"normalize_advantage": True}])
def test_an_advantage_that_agents_share_counts_for_each_as_in_clip_ppo(distribution, values, how):
    loss, data = loss_and_batch(distribution, values, **how)
    actor, critic = loss.actor_network, loss.critic_network
    more = {"loss_critic_type": "l2", "clip_value": 0.2, "entropy_coeff": 0.01, "functional": False}
    stock = ClipPPOLoss(actor, critic, **more, **how)
    slopes = []
    for one in (loss, stock):
        parts = one(data)
        slopes.append(torch.autograd.grad(sum(parts[key] for key in LOSSES), list(actor.parameters())))
    found, expected = loss(data), stock(data)
    for key in (*LOSSES, "clip_fraction", "kl_approx"):
        torch.testing.assert_close(found[key], expected[key])
    torch.testing.assert_close(*slopes)


def test_a_mask_of_states_leaves_out_what_agents_share_and_what_is_theirs():
    loss, data = loss_and_batch(normalize_advantage=True)
    expected = loss(data[:5])
    data["collector", "mask"] = torch.arange(STATES) < 5
    found = loss(data)
    for key in loss.out_keys:
        torch.testing.assert_close(found[key], expected[key])


def test_candidates_share_nothing_of_it():
    loss, data = loss_and_batch(kl_bound=torch.tensor([0.1, 1.0]), normalize_advantage=True)
    one, _ = loss_and_batch(normalize_advantage=True)
    found = loss(data.reshape(2, STATES // 2))
    for index, half in enumerate(data.split(STATES // 2)):
        torch.testing.assert_close(found["loss_objective"][index], one(half)["loss_objective"])
        torch.testing.assert_close(found["loss_critic"][index], one(half)["loss_critic"])


def test_a_target_of_each_agent_is_none_of_a_value_that_they_share():
    loss, data = loss_and_batch()
    data["value_target"] = torch.randn(STATES, AGENTS, 1)
    with pytest.raises(ValueError, match=r"^'state_value' is \(8, 1\), 'value_target' \(8, 3\); expected as many"):
        loss(data)


def test_what_is_shared_keeps_a_dimension_of_one():
    loss, data = loss_and_batch()
    data["advantage"] = data["advantage"].squeeze(-1)
    said = r"^'advantage' has the shape \(8,\), the actor's log-probabilities \(8, 3\).*ends with a dimension of 1"
    with pytest.raises(ValueError, match=said):
        loss(data)


def test_no_value_is_looked_at_where_that_would_wait_for_a_gpu():
    loss, data = loss_and_batch(normalize_advantage=True)
    data["collector", "mask"] = torch.arange(STATES) < 5
    assert loss.to("meta")(data.to("meta"))["loss_objective"].is_meta  # a device on which asking for a value raises


def test_one_number_in_a_batch_without_a_size_is_none_that_agents_share_of_a_state():
    loss, data = loss_and_batch()
    data.batch_size = []
    data["advantage"] = torch.ones(1)
    with pytest.raises(ValueError, match=r"'advantage' has the shape \(1,\), the actor's log-probabilities \(8, 3\)"):
        loss(data)
