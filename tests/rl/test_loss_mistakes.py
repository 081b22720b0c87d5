"""What a loss cannot train with is told where it is given, in one line, and not by torch in the first batch."""

from __future__ import annotations

import pytest
import torch
from test_loss_shapes import actor_of, loss_and_batch
from torch import nn
from torchrl.modules import ValueOperator

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


def test_an_actor_without_gradients_is_told_once_since_the_critic_would_learn_alone():
    loss, data = loss_and_batch()
    loss.actor_network.requires_grad_(False)
    with torch.no_grad():
        loss(data)  # whoever asks for no gradient wants none
    with pytest.warns(UserWarning, match="^No parameter of actor_network asks for gradients"):
        loss(data)
    loss(data)  # warnings are errors here
