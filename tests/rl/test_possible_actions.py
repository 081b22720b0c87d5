"""Actions that the actor never gives are told: their clamped densities teach nothing, or torch speaks of an index."""

from __future__ import annotations

import pytest
import tensordict.nn as tensordict_nn
import torch
from test_loss_shapes import loss_and_batch
from torch import distributions as D
from torchrl.envs.utils import ExplorationType, set_exploration_type
from torchrl.modules import (
    IndependentNormal,
    MaskedCategorical,
    OneHotCategorical,
    TanhNormal,
    TruncatedNormal,
)

from hts.rl.possible import impossible

ZERO, ONE = torch.zeros(5, 2), torch.ones(5, 2)
WIDE = {"low": torch.tensor([-2.0, 1.0]), "high": torch.tensor([2.0, 4.0])}


def beta() -> D.Independent:
    return D.Independent(D.Beta(2 * ONE, 2 * ONE), 1)


@pytest.mark.parametrize(
    ("policy", "action"),
    [
        (TanhNormal(ZERO, ONE), 1.5),
        (TanhNormal(ZERO, ONE), 2),  # a whole number
        (TanhNormal(ZERO, ONE, **WIDE), 0.5),  # of the second only
        (TruncatedNormal(ZERO, 0.3 * ONE), -1.5),
        (TruncatedNormal(ZERO, ONE, **WIDE), 0.5),  # of the second only
        (D.Independent(tensordict_nn.distributions.TruncatedNormal(ZERO, 3 * ONE, -ONE, ONE), 1), 1.5),
        (TanhNormal(ZERO, ONE, low=9.9, high=10.1), 9.85),
        (beta(), 1.5),
        (D.TransformedDistribution(beta(), [D.AffineTransform(-1.0, 2.0)]), 1.5),  # from -1 to 1
        (D.TransformedDistribution(beta(), [D.AffineTransform(WIDE["high"], -ONE[0], event_dim=1)]), 0.4),
        (D.TransformedDistribution(TanhNormal(ZERO, ONE), [D.ExpTransform()]), 0.3),  # from 1/e to e
        (D.Independent(D.Kumaraswamy(2 * ONE, 2 * ONE), 1), 1.5),
        (D.Independent(D.LogNormal(ZERO, ONE), 1), -0.5),
        (D.Independent(D.Gamma(2 * ONE, ONE), 1), -0.5),
        (D.Dirichlet(ONE), -0.5),
        (D.Categorical(logits=torch.zeros(5, 4)), 4),
        (D.Categorical(logits=torch.zeros(5, 4)), 1.5),
        (D.Independent(D.Categorical(logits=torch.zeros(5, 2, 4)), 1), -1),
        (D.Bernoulli(logits=torch.zeros(5)), 0.5),
        (OneHotCategorical(logits=torch.zeros(5, 4)), 0.0),
        (D.OneHotCategorical(logits=torch.zeros(5, 4)), 0.25),
        (tensordict_nn.distributions.OneHotCategorical(logits=torch.zeros(5, 4)), 0.25),
        (MaskedCategorical(logits=torch.zeros(5, 4), mask=torch.arange(4).expand(5, -1) != 2), 2),
        (MaskedCategorical(logits=torch.zeros(5, 4), mask=torch.arange(4).expand(5, -1) != 2), 4),
        (MaskedCategorical(logits=torch.zeros(5, 4), indices=torch.tensor([1, 3]).expand(5, -1)), 2),
    ],
)
def test_what_is_beyond_limits_or_of_no_choice_is_seen(policy, action):
    own = torch.cat([policy.sample() for _ in range(80)]).unflatten(0, (80, -1))  # of masks, no other shape
    for drawn in own:
        assert not bool(impossible(policy, drawn).any())
        assert not bool(impossible(policy, drawn.half().to(own.dtype)).any())  # kept in less precision
    whole = isinstance(action, int)
    found = impossible(policy, torch.full_like(own[0], action, dtype=torch.long if whole else torch.float32))
    expected = torch.tensor([False, True]) if action == 0.5 and found.ndim == 2 else True
    assert bool((found == expected).all())


@pytest.mark.parametrize(
    "policy",
    [
        IndependentNormal(ZERO, ONE),
        D.MultivariateNormal(ZERO, torch.eye(2)),
        D.Uniform(ZERO.clone().requires_grad_(), ONE),  # limits that are learned: they were others when it acted
        D.TransformedDistribution(beta(), [D.AffineTransform(ZERO.clone().requires_grad_(), ONE, event_dim=1)]),
    ],
)
def test_nothing_is_said_of_others(policy):
    assert impossible(policy, policy.sample()) is None


def test_actions_in_the_precision_of_the_policy_are_never_beyond_limits():
    torch.manual_seed(0)
    low, high = torch.tensor([9.9, 0.3], dtype=torch.bfloat16), torch.tensor([10.1, 0.7], dtype=torch.bfloat16)
    loc = torch.randn(400, 2, dtype=torch.bfloat16)
    for kind in (TanhNormal, TruncatedNormal):
        policy = kind(loc, torch.ones_like(loc), low=low, high=high)
        assert not bool(impossible(policy, policy.sample()).any())


def test_of_a_support_that_is_not_said_nothing_is_known():
    class Own(D.Normal):
        support = D.constraints.dependent

    assert impossible(Own(ZERO, ONE), ONE) is None


def test_an_actor_learns_from_its_own_actions_of_a_truncated_normal():
    loss, data = loss_and_batch(distribution=TruncatedNormal)
    with set_exploration_type(ExplorationType.RANDOM), torch.no_grad():
        loss.actor_network(data)
    assert torch.isfinite(loss(data)["loss_objective"])


def test_the_loss_says_which_action_it_was_and_does_not_look_at_filling():
    loss, data = loss_and_batch(distribution=TanhNormal)
    data["action"][3, 1] = 1.5
    with pytest.raises(
        ValueError, match=r"^'action' is 1.5 at \[3, 1\], in 1 of 16 numbers.*\(TanhNormal\) never gives"
    ):
        loss(data)
    data["collector", "mask"] = torch.arange(8) < 3
    loss(data)


def test_actions_that_carry_gradients_are_told():
    loss, data = loss_and_batch()
    data["action"] = data["action"].clone().requires_grad_()
    with pytest.raises(ValueError, match="^The batch's 'action' carries gradients"):
        loss(data)


def test_a_value_that_the_critic_writes_elsewhere_is_told():
    loss, data = loss_and_batch()
    loss.set_keys(value="worth")
    with pytest.raises(KeyError, match="critic_network writes 'state_value', and no 'worth'.*set_keys"):
        loss(data)
