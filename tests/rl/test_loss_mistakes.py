"""What a loss cannot train with is told where it is given, in one line, and not by torch in the first batch."""

from __future__ import annotations

import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from test_loss_shapes import actor_of, loss_and_batch
from torch import nn
from torch.distributions import Independent, StudentT
from torchrl.envs.utils import ExplorationType, set_exploration_type
from torchrl.modules import Delta, IndependentNormal, NormalParamExtractor, ProbabilisticActor, TanhDelta, ValueOperator
from torchrl.objectives import ClipPPOLoss
from torchrl.objectives.value import GAE

from hts.rl import KLConstrainedPPOLoss, Population, PopulationActor, PopulationCritic, Sizes

NAN = float("nan")


def critic() -> ValueOperator:
    return ValueOperator(nn.Linear(3, 1), in_keys=["observation"])


@pytest.mark.parametrize("reference", [nn.Linear(3, 2), critic(), actor_of().state_dict()])
def test_a_reference_that_gives_no_distribution_is_refused_when_the_loss_is_made(reference):
    with pytest.raises(TypeError, match=rf"^reference is a {type(reference).__name__} without get_dist"):
        KLConstrainedPPOLoss(actor_of(), critic(), reference=reference)


@pytest.mark.parametrize(
    ("how", "said"),
    [
        ({"critic_coeff": NAN}, "critic_coeff is nan; expected a number from 0 on"),
        ({"critic_coeff": -1.0}, "critic_coeff is -1.0"),
        ({"entropy_coeff": NAN}, "entropy_coeff is nan; expected a finite number"),
        ({"clip_value": NAN}, "clip_value is nan; expected a number from 0 on"),
        ({"clip_value": -0.2}, "clip_value is -0.2"),
        ({"kl_bound": torch.tensor([])}, r"kl_bound is \[\]; expected positive numbers"),
    ],
)
def test_a_number_with_which_nothing_or_the_opposite_is_learned_is_refused(how, said):
    with pytest.raises(ValueError, match=said):
        loss_and_batch(**how)


@pytest.mark.parametrize("several", [False, True])
@pytest.mark.parametrize("bound", ["0.5", None])
def test_a_bound_that_is_no_number_is_told(bound, several):
    actor, values = actor_of(), critic()
    if several:
        population = Population(Sizes(3, 3, 2, (4,)), 2)
        actor, values = PopulationActor(population), PopulationCritic(population)
    with pytest.raises(TypeError, match=rf"^kl_bound is {bound!r}; expected a number, or \[P\] for P candidates"):
        KLConstrainedPPOLoss(actor, values, kl_bound=bound)


@pytest.mark.parametrize("nested", [False, True])
def test_the_actor_says_where_its_action_is_as_in_torchrls_losses(nested):
    act, seen = ("team", "act") if nested else "act", ("team", "seen") if nested else "seen"
    head = TensorDictModule(nn.Sequential(nn.Linear(3, 4), NormalParamExtractor()), [seen], ["loc", "scale"])
    actor = ProbabilisticActor(
        head, in_keys=["loc", "scale"], out_keys=[act], distribution_class=IndependentNormal, return_log_prob=True
    )
    values = ValueOperator(nn.Linear(3, 1), in_keys=[seen])
    data = TensorDict({seen: torch.randn(8, 3), "advantage": torch.randn(8, 1), "value_target": torch.randn(8, 1)}, [8])
    with torch.no_grad():
        values(actor(data))
    loss, stock = KLConstrainedPPOLoss(actor, values), ClipPPOLoss(actor, values)
    torch.testing.assert_close(loss(data)["loss_objective"], stock(data)["loss_objective"])
    assert act in loss.in_keys
    loss.set_keys(action="other")  # who says otherwise is heard
    with pytest.raises(KeyError, match="The batch has no 'other'"):
        loss(data)


def test_an_estimator_may_be_named_as_torchrl_names_it():
    loss = KLConstrainedPPOLoss(actor_of(), critic())
    assert type(loss.make_value_estimator("gae", gamma=0.9).value_estimator) is GAE
    with pytest.raises(NotImplementedError, match="^td0 is not supported, GAE is"):
        loss.make_value_estimator("td0")


def test_an_actor_without_gradients_is_told_once_since_the_critic_would_learn_alone():
    loss, data = loss_and_batch()
    loss.actor_network.requires_grad_(False)
    with torch.no_grad():
        loss(data)  # whoever asks for no gradient wants none
    with pytest.warns(UserWarning, match="^No parameter of actor_network asks for gradients"):
        loss(data)
    loss(data)  # warnings are errors here


@pytest.mark.parametrize("kind", [Delta, TanhDelta])
def test_a_policy_that_draws_nothing_is_refused_when_the_loss_is_made(kind):
    module = TensorDictModule(nn.Linear(3, 2), ["observation"], ["param"])
    actor = ProbabilisticActor(module, in_keys=["param"], distribution_class=kind, return_log_prob=True)
    with pytest.raises(TypeError, match=rf"^actor_network has a {kind.__name__}, one action in each state"):
        KLConstrainedPPOLoss(actor, critic())


class Rough(StudentT):
    """Its actions are a StudentT's, and the gradient through them is NaN."""

    def rsample(self, sample_shape=()):
        return super().rsample(sample_shape) + (self.loc - self.loc).sqrt()


def test_a_kl_that_does_not_pull_spoils_no_gradient():
    with set_exploration_type(ExplorationType.RANDOM):
        loss, data = loss_and_batch(distribution=lambda loc, scale: Independent(Rough(4.0, loc, scale), 1))
    weights = list(loss.actor_network.parameters())
    for kind in (loss, ClipPPOLoss(loss.actor_network, loss.critic_network, entropy_bonus=False, functional=False)):
        slopes = torch.autograd.grad(kind(data)["loss_objective"], weights)
        assert all(bool(slope.isfinite().all()) for slope in slopes)
