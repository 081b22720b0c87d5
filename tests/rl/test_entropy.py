"""The entropy of actions that a tanh has squashed, where it has no closed form."""

from __future__ import annotations

import math

import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torch import nn
from torch.distributions import Independent, Poisson
from torchrl.modules import ProbabilisticActor, TanhNormal, ValueOperator
from torchrl.objectives import ClipPPOLoss

from hts.rl import KLConstrainedPPOLoss
from hts.rl.entropy import entropy_of

COUNT, SIGMA = 5000, 0.3


class Constant(nn.Module):
    """One mean and one sigma in all states."""

    def __init__(self, mean: float) -> None:
        super().__init__()
        self.mean, self.log_std = nn.Parameter(torch.tensor([mean])), nn.Parameter(torch.tensor([math.log(SIGMA)]))

    def forward(self, observation):
        shape = (*observation.shape[:-1], 1)
        return self.mean.expand(shape), self.log_std.exp().expand(shape)


@pytest.mark.parametrize("mean", [0.0, 3.0, 10.0])  # at 10 every action is rounded to 1
def test_it_is_right_to_the_end_of_the_tanh_and_pulls_as_in_clip_ppo(mean):
    head = Constant(mean)
    module = TensorDictModule(head, ["observation"], ["loc", "scale"])
    actor = ProbabilisticActor(module, in_keys=["loc", "scale"], distribution_class=TanhNormal, return_log_prob=True)
    critic = ValueOperator(nn.Linear(1, 1), in_keys=["observation"])
    names = ("observation", "advantage", "value_target")
    data = TensorDict({name: torch.zeros(COUNT, 1) for name in names}, [COUNT])
    with torch.no_grad():
        critic(actor(data))
    found, slopes = [], []
    for kind in (KLConstrainedPPOLoss, ClipPPOLoss):
        torch.manual_seed(0)
        loss = kind(actor, critic, entropy_coeff=1.0)(data)["loss_entropy"]
        found.append(-loss.detach())
        slopes.append(torch.stack(torch.autograd.grad(loss, [head.mean, head.log_std])))
    torch.testing.assert_close(found[0], found[1])
    torch.testing.assert_close(slopes[0], slopes[1])
    # H[tanh(x)] = H[x] + E[ln(1 - tanh^2 x)], where 1 - tanh^2 x = 4 e^(-2x) / (1 + e^(-2x))^2
    x = mean + SIGMA * torch.randn(COUNT, dtype=torch.float64)
    by_hand = 0.5 + math.log(SIGMA * math.sqrt(2 * math.pi)) + (math.log(4) - 2 * x - 2 * (-2 * x).exp().log1p()).mean()
    assert float(found[0]) == pytest.approx(float(by_hand), abs=0.05)


def test_where_neither_a_formula_nor_a_sample_gives_it_that_is_told():
    counts = Independent(Poisson(torch.ones(4, 2)), 1)
    with pytest.raises(NotImplementedError, match="^torch knows no entropy of Poisson.*entropy_coeff=0"):
        entropy_of(counts, torch.zeros(4))
