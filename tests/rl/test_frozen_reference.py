"""The reference of a loss is a copy of the actor, whatever TorchRL keeps the actor's parameters in."""

from __future__ import annotations

import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from test_loss_shapes import actor_of
from torch import nn
from torchrl.modules import IndependentNormal, MultiAgentMLP, NormalParamExtractor, ProbabilisticActor, ValueOperator

from hts.rl import KLConstrainedPPOLoss, project_actor_to_kl_bound

AGENTS = 3


def team(share: bool, seed: int) -> ProbabilisticActor:
    """One policy for all agents, or one for each."""
    torch.manual_seed(seed)
    net = MultiAgentMLP(3, 4, AGENTS, centralised=False, share_params=share, depth=1, num_cells=4)
    read, shown = ("agents", "observation"), [("agents", "loc"), ("agents", "scale")]
    module = TensorDictModule(nn.Sequential(net, NormalParamExtractor()), [read], shown)
    return ProbabilisticActor(
        module, in_keys=shown, out_keys=[("agents", "action")], distribution_class=IndependentNormal
    )


@pytest.mark.parametrize("share", [True, False])
def test_agents_of_torchrl_are_held_to_what_they_were(share):
    critic = ValueOperator(nn.Linear(3, 1), in_keys=[("agents", "observation")])
    loss = KLConstrainedPPOLoss(team(share, seed=0), critic)
    data = TensorDict({"agents": {"observation": torch.randn(8, AGENTS, 3)}}, [8])
    assert float(loss.kl_to_reference(data)) == 0.0
    assert not list(loss.reference.parameters())
    with torch.no_grad():
        for parameter in loss.actor_network.parameters():
            parameter.add_(0.3)
    kl = loss.kl_to_reference(data)
    assert float(kl) > 0.01
    other = KLConstrainedPPOLoss(team(share, seed=1), critic)
    other.load_state_dict(loss.state_dict())
    assert torch.equal(other.kl_to_reference(data), kl)
    project_actor_to_kl_bound(loss.actor_network, loss.reference, data, float(kl) / 2)
    assert float(loss.kl_to_reference(data)) == pytest.approx(float(kl) / 2, rel=0.01)


def test_an_actor_without_parameters_yet_is_told_what_it_lacks():
    lazy = TensorDictModule(nn.Sequential(nn.LazyLinear(4), NormalParamExtractor()), ["observation"], ["loc", "scale"])
    actor = ProbabilisticActor(lazy, in_keys=["loc", "scale"], distribution_class=IndependentNormal)
    critic = ValueOperator(nn.Linear(3, 1), in_keys=["observation"])
    with pytest.raises(ValueError, match="^actor_network has parameters without a shape yet"):
        KLConstrainedPPOLoss(actor, critic)
    with pytest.raises(ValueError, match="^reference has parameters without a shape yet"):
        KLConstrainedPPOLoss(actor_of(), critic, reference=actor)
    actor(TensorDict({"observation": torch.randn(2, 3)}, [2]))
    KLConstrainedPPOLoss(actor, critic)
