"""Policies that choose among actions, by number or one-hot, beside TorchRL's `ClipPPOLoss`."""

from __future__ import annotations

import math
import re

import pytest
import tensordict.nn as tensordict_nn
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torch import distributions as D
from torch import nn
from torchrl.data import OneHot
from torchrl.envs.utils import ExplorationType, set_exploration_type
from torchrl.modules import (
    MaskedCategorical,
    MaskedOneHotCategorical,
    OneHotCategorical,
    ProbabilisticActor,
    ValueOperator,
)
from torchrl.objectives import ClipPPOLoss

from hts.rl import KLConstrainedPPOLoss, distribution_kl

COUNT, CHOICES = 32, 4


def without_the_third(logits: torch.Tensor) -> torch.Tensor:
    return logits.masked_fill(torch.arange(CHOICES) == 2, -math.inf)


def one_hot_but_one(logits):
    return D.OneHotCategorical(logits=without_the_third(logits))


def two_choices(logits):
    """The first of two, and one of two of which the second may not be done."""
    return D.Independent(D.Categorical(logits=without_the_third(logits).unflatten(-1, (2, 2))), 1)


def two_one_hot_choices(logits):
    return D.Independent(OneHotCategorical(logits=logits.unflatten(-1, (2, 2))), 1)


def loss_and_batch(distribution, choices: int = CHOICES, **how) -> tuple[KLConstrainedPPOLoss, TensorDict]:
    torch.manual_seed(0)
    head = TensorDictModule(nn.Linear(3, choices), ["observation"], ["logits"])
    masks = distribution in (MaskedCategorical, MaskedOneHotCategorical)
    actor = ProbabilisticActor(
        head,
        in_keys=["logits", "mask"] if masks else ["logits"],
        distribution_class=distribution,
        return_log_prob=True,
        spec=OneHot(choices) if distribution is OneHotCategorical else None,
    )
    data = TensorDict({"observation": torch.randn(COUNT, 3)}, [COUNT])
    data["mask"] = torch.arange(choices).expand(COUNT, -1) != 2
    critic = ValueOperator(nn.Linear(3, 1), in_keys=["observation"])
    with torch.no_grad(), set_exploration_type(ExplorationType.RANDOM):
        critic(actor(data))
    data["action_log_prob"] += 0.3 * torch.randn(COUNT)
    data["advantage"], data["value_target"] = torch.randn(COUNT, 1), torch.randn(COUNT, 1)
    return KLConstrainedPPOLoss(actor, critic, **how), data


@pytest.mark.parametrize(
    "distribution",
    [
        D.Categorical,
        OneHotCategorical,
        tensordict_nn.distributions.OneHotCategorical,
        MaskedCategorical,
        MaskedOneHotCategorical,
        one_hot_but_one,
        two_choices,
        two_one_hot_choices,
    ],
)
def test_a_policy_that_chooses_learns_as_in_clip_ppo_and_is_held_to_its_reference(distribution):
    loss, data = loss_and_batch(distribution, kl_bound=1.0)
    weights = list(loss.actor_network.parameters())
    found, stock = loss(data), ClipPPOLoss(loss.actor_network, loss.critic_network, entropy_bonus=False)(data)
    torch.testing.assert_close(found["loss_objective"], stock["loss_objective"])
    assert all(bool(slope.isfinite().all()) for slope in torch.autograd.grad(found["loss_objective"], weights))
    with torch.no_grad():
        weights[0].add_(torch.randn_like(weights[0]))
    loss.update_multiplier(torch.tensor(3.0))
    found = loss(data)
    policy, reference = (one.get_dist(data.copy()) for one in (loss.actor_network, loss.reference))
    p, q = (one.base_dist if isinstance(one, D.Independent) else one for one in (policy, reference))
    by_hand = (p.probs * (p.probs / q.probs).log()).nan_to_num(0.0)  # 0 ln(0 / 0) where neither may
    assert float(found["kl"]) == pytest.approx(float(by_hand.sum().detach()) / COUNT, rel=1e-5)
    assert all(bool(slope.isfinite().all()) for slope in torch.autograd.grad(found["loss_objective"], weights))


def test_one_hot_actions_of_another_width_are_told():
    loss, data = loss_and_batch(OneHotCategorical)
    data["action"] = data["action"][:, :3]
    with pytest.raises(ValueError, match=re.escape("'action' has the shape (32, 3), expected (32, 4)")):
        loss(data)


def test_a_reference_that_chooses_among_others_is_none():
    policy, reference = (D.Categorical(logits=torch.zeros(2, count)) for count in (4, 5))
    with pytest.raises(ValueError, match="chooses among 4 actions, its reference among 5"):
        distribution_kl(policy, reference)
