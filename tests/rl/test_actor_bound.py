"""A policy of TorchRL's own that ended beyond its bound is pulled back onto it."""

from __future__ import annotations

import copy
import math

import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import NormalParamExtractor, TensorDictModule
from test_loss_shapes import actor_of, loss_and_batch
from torch import nn
from torchrl.modules import ProbabilisticActor, TanhNormal, TruncatedNormal

from hts.rl import (
    KLConstrainedPPOLoss,
    Population,
    PopulationActor,
    Sizes,
    distribution_kl,
    project_actor_to_kl_bound,
)


def moved(distribution=TanhNormal) -> tuple[KLConstrainedPPOLoss, TensorDict]:
    loss, _ = loss_and_batch(distribution=distribution)
    with torch.no_grad():
        for parameter in loss.actor_network.parameters():
            parameter.add_(0.3 * torch.randn_like(parameter))
    return loss, TensorDict({"observation": torch.randn(100, 5, 3)}, [100, 5])


def vector(actor) -> torch.Tensor:
    return torch.cat([parameter.detach().flatten() for parameter in actor.parameters()])


def test_an_actor_that_ended_beyond_its_bound_is_pulled_back_onto_it():
    loss, data = moved()
    end, start = vector(loss.actor_network), torch.cat([one.flatten() for one in loss.reference.buffers()])
    before = float(loss.kl_to_reference(data))
    assert before > 0.1
    scale = project_actor_to_kl_bound(loss.actor_network, loss.reference, data, 0.05)
    assert 0.95 * 0.05 < float(loss.kl_to_reference(data)) <= 0.05
    torch.testing.assert_close(vector(loss.actor_network), start + scale * (end - start))
    assert loss.actor_network.get_dist(data).log_prob(torch.zeros(100, 5, 2)).requires_grad  # and may learn on


@pytest.mark.parametrize("bound", [9.0, math.inf])
def test_one_that_is_inside_stays_what_it_is(bound):
    loss, data = moved()
    end = vector(loss.actor_network)
    assert project_actor_to_kl_bound(loss.actor_network, loss.reference, data, bound) == 1.0
    assert torch.equal(vector(loss.actor_network), end)


@pytest.mark.parametrize("layer", [nn.Dropout(0.3), nn.BatchNorm1d(3)], ids=["dropout", "batch norm"])
def test_what_differs_while_training_is_judged_as_it_will_act_and_left_as_it_was(layer):
    inner = nn.Sequential(layer, nn.Linear(3, 4), NormalParamExtractor())
    actor = ProbabilisticActor(
        TensorDictModule(inner, ["observation"], ["loc", "scale"]),
        in_keys=["loc", "scale"],
        distribution_class=TanhNormal,
        return_log_prob=True,
    )
    reference, data = copy.deepcopy(actor), TensorDict({"observation": torch.randn(200, 3)}, [200])
    with torch.no_grad():
        for parameter in actor.parameters():
            parameter.add_(0.5 * torch.randn_like(parameter))
    kept = [buffer.clone() for network in (actor, reference) for buffer in network.buffers()]
    assert 0.0 < project_actor_to_kl_bound(actor, reference, data, 0.01) < 1.0
    now = [buffer for network in (actor, reference) for buffer in network.buffers()]
    assert all(torch.equal(one, other) for one, other in zip(kept, now, strict=True))
    assert all(module.training for network in (actor, reference) for module in network.modules())


def test_a_copy_of_the_actor_is_a_reference_as_the_losss_own_is():
    actor, data = actor_of(), TensorDict({"observation": torch.randn(500, 3)}, [500])
    reference = copy.deepcopy(actor)
    with torch.no_grad():
        next(actor.parameters()).add_(1.0)
    assert 0.0 < project_actor_to_kl_bound(actor, reference, data, 0.1) < 1.0
    kl = distribution_kl(actor.get_dist(data.copy()), reference.get_dist(data.copy())).mean().detach()
    assert 0.095 < float(kl) <= 0.1


@pytest.mark.parametrize("bad", ["weight", "state"])
def test_a_number_that_is_none_is_told_and_nothing_changes(bad):
    loss, data = moved()
    if bad == "weight":
        with torch.no_grad():
            next(loss.actor_network.parameters())[0, 0] = math.nan
    else:
        data["observation"][3] = math.nan
    end = vector(loss.actor_network)
    with pytest.raises(ValueError, match="^The KL is nan, .*not finite"):
        project_actor_to_kl_bound(loss.actor_network, loss.reference, data, 0.05)
    assert torch.equal(vector(loss.actor_network).nan_to_num(), end.nan_to_num())


def test_what_cannot_be_shrunk_is_refused():
    loss, data = moved()
    with pytest.raises(ValueError, match="^bound is 0.0; expected a positive number"):
        project_actor_to_kl_bound(loss.actor_network, loss.reference, data, 0.0)
    with pytest.raises(ValueError, match="nothing is in it"):
        project_actor_to_kl_bound(loss.actor_network, loss.reference, data[:0], 0.1)
    with pytest.raises(ValueError, match="^reference has no '.*' of the actor's shape"):
        project_actor_to_kl_bound(loss.actor_network, actor_of(1), data, 0.1)
    one = PopulationActor(Population(Sizes(3, 3, 1, (4,)), 1))
    with pytest.raises(TypeError, match=r"^actor is of a population; project_to_kl_bound"):
        project_actor_to_kl_bound(one, one, data, 0.1)


def test_what_differs_in_more_than_parameters_is_told():
    class Shifted(torch.nn.Linear):
        """A head behind a normaliser."""

        def __init__(self, shift: float) -> None:
            super().__init__(3, 4)
            self.register_buffer("shift", torch.tensor(shift))

        def forward(self, observation):
            return super().forward(observation + self.shift)

    data = TensorDict({"observation": torch.randn(50, 3)}, [50])
    actor, reference = actor_of(), actor_of()
    for one, shift in ((actor, 0.0), (reference, 5.0)):
        one[0].module[0] = Shifted(shift)
    end = vector(actor)
    with pytest.raises(ValueError, match="differ in more than parameters, such as a normaliser"):
        project_actor_to_kl_bound(actor, reference, data, 1e-3)
    assert torch.equal(vector(actor), end)


def test_a_bound_on_a_sampled_kl_holds_for_the_draws_that_it_was_found_with():
    loss, data = moved(TruncatedNormal)
    before = torch.get_rng_state()
    assert project_actor_to_kl_bound(loss.actor_network, loss.reference, data, 0.05) < 1.0
    assert torch.equal(torch.get_rng_state(), before)
    assert 0.9 * 0.05 < float(loss.kl_to_reference(data)) <= 0.05
