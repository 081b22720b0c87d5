"""A recurrent actor of TorchRL's own is held near its reference, which goes along with the same stretches."""

from __future__ import annotations

import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import ProbabilisticTensorDictModule, ProbabilisticTensorDictSequential, TensorDictModule
from torch import nn
from torchrl.modules import LSTMModule, NormalParamExtractor, TanhNormal, ValueOperator, set_recurrent_mode

from hts.rl import KLConstrainedPPOLoss, project_actor_to_kl_bound

KEYS = {
    "in_keys": ["observation", "hidden", "cell"],
    "out_keys": ["felt", ("next", "hidden"), ("next", "cell")],
}
STRETCHES, STEPS, SIZE = 2, 5, 4


def made(seed: int) -> KLConstrainedPPOLoss:
    torch.manual_seed(seed)
    memory = LSTMModule(input_size=3, hidden_size=SIZE, **KEYS)
    head = TensorDictModule(nn.Sequential(nn.Linear(SIZE, 2), NormalParamExtractor()), ["felt"], ["loc", "scale"])
    drawn = ProbabilisticTensorDictModule(
        ["loc", "scale"], ["action"], distribution_class=TanhNormal, return_log_prob=True
    )
    critic = ValueOperator(nn.Linear(3, 1), in_keys=["observation"])
    return KLConstrainedPPOLoss(ProbabilisticTensorDictSequential(memory, head, drawn), critic)


def stretches() -> TensorDict:
    shape = (STRETCHES, STEPS)
    begun = torch.zeros(*shape, 1, dtype=torch.bool)
    begun[:, 0] = True
    empty = torch.zeros(*shape, 1, SIZE)
    entries = {"observation": torch.randn(*shape, 3), "is_init": begun, "hidden": empty, "cell": empty.clone()}
    return TensorDict(entries, shape)


def test_its_reference_remembers_and_is_gone_on_from():
    loss, data = made(seed=0), stretches()
    later = data.clone()
    later["observation"][:, 0] += 3.0  # the first step alone
    with set_recurrent_mode(True):
        assert float(loss.kl_to_reference(data)) == 0.0
        with torch.no_grad():
            for parameter in loss.actor_network.parameters():
                parameter.add_(0.3)
        kl = loss.kl_to_reference(data)
        assert float(kl) > 0.01
        last = [loss.reference.get_dist(one.copy()).base_dist.base_dist.loc[:, -1] for one in (data, later)]
        assert not torch.allclose(*last)  # what the first step showed is remembered in the last one
        other = made(seed=1)
        other.load_state_dict(loss.state_dict())
        assert torch.equal(other.kl_to_reference(data), kl)


def test_it_goes_along_the_stretches_outside_of_that_mode_too():
    loss, data = made(seed=0), stretches()
    with torch.no_grad():
        for parameter in loss.actor_network.parameters():
            parameter.add_(0.3)
    with set_recurrent_mode(True):
        kl = loss.kl_to_reference(data)
    assert torch.equal(loss.kl_to_reference(data), kl)
    bound = 0.5 * float(kl)
    scale = project_actor_to_kl_bound(loss.actor_network, loss.reference, data, bound)
    with set_recurrent_mode(True):
        assert 0.0 < scale < 1.0 and float(loss.kl_to_reference(data)) == pytest.approx(bound, rel=0.01)
