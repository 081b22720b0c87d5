"""The loss on a GPU: a CPU's values, and nothing waits for the device. Skipped without CUDA.

TorchRL's TanhNormal and TruncatedNormal wait where they are made, for their limits, which hts cannot change.
"""

from __future__ import annotations

import copy
from collections.abc import Iterator
from contextlib import contextmanager

import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import InteractionType, NormalParamExtractor, TensorDictModule
from torch import nn
from torch.distributions import Categorical
from torchrl.data import OneHot
from torchrl.modules import (
    IndependentNormal,
    MaskedCategorical,
    OneHotCategorical,
    ProbabilisticActor,
    TanhNormal,
    TruncatedNormal,
    ValueOperator,
)

from hts.rl import KLConstrainedPPOLoss

pytestmark = pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA device")

COUNT, STEPS, CHOICES = 64, 6, 4
KINDS = (IndependentNormal, Categorical, MaskedCategorical, OneHotCategorical, TanhNormal, TruncatedNormal)
LIMITED = (TanhNormal, TruncatedNormal)


@contextmanager
def nothing_waits() -> Iterator[None]:
    torch.cuda.synchronize()
    try:
        torch.cuda.set_sync_debug_mode("error")
        yield
    finally:
        torch.cuda.set_sync_debug_mode("default")


def loss_and_batch(kind: type, filled: bool) -> tuple[KLConstrainedPPOLoss, TensorDict]:
    torch.manual_seed(0)
    if kind in (IndependentNormal, *LIMITED):
        network, names = nn.Sequential(nn.Linear(3, 4), NormalParamExtractor()), ["loc", "scale"]
    else:
        network, names = nn.Linear(3, CHOICES), ["logits"]
    actor = ProbabilisticActor(
        TensorDictModule(network, ["observation"], names),
        in_keys=[*names, "mask"] if kind is MaskedCategorical else names,
        distribution_class=kind,
        default_interaction_type=InteractionType.RANDOM,
        return_log_prob=True,
        spec=OneHot(CHOICES) if kind is OneHotCategorical else None,
    )
    critic = ValueOperator(nn.Linear(3, 1), in_keys=["observation"])
    data = TensorDict({"observation": torch.randn(COUNT, STEPS, 3)}, [COUNT, STEPS])
    data["mask"] = (torch.arange(CHOICES) != 2).repeat(COUNT, STEPS, 1)
    with torch.no_grad():
        critic(actor(data))
    data["action_log_prob"] += 0.3 * torch.randn(COUNT, STEPS)
    data["advantage"], data["value_target"] = torch.randn(COUNT, STEPS, 1), torch.randn(COUNT, STEPS, 1)
    if filled:
        data["collector", "mask"] = torch.rand(COUNT, STEPS) > 0.3
    coefficient = 0.0 if kind in LIMITED else 0.01  # whose entropy is of one sample, another on each device
    return KLConstrainedPPOLoss(actor, critic, entropy_coeff=coefficient, clip_value=0.2), data


@pytest.mark.filterwarnings("ignore:Synchronization debug mode is a prototype")  # torch says so once, after setting it
@pytest.mark.parametrize("filled", [False, True])
@pytest.mark.parametrize("kind", KINDS)
def test_it_is_that_of_a_cpu_and_waits_for_nothing(kind, filled):
    here, data = loss_and_batch(kind, filled)
    with torch.no_grad():
        for parameter in here.actor_network.parameters():
            parameter.add_(0.2 * torch.randn_like(parameter))
    there, batch = copy.deepcopy(here).to("cuda"), data.to("cuda")
    expected = here(data)
    there(batch)  # what is made once is made now
    if kind in LIMITED:
        found = there(batch)
    else:
        with nothing_waits():
            found = there(batch)
            (found["loss_objective"] + found["loss_critic"] + found["loss_entropy"]).backward()
            there.kl_to_reference(batch)
    for name, value in expected.items():
        if name == "kl" and kind is TruncatedNormal:
            continue  # an estimate by one action, another on each device
        if name == "loss_objective" and kind is TruncatedNormal:
            continue  # it holds that KL
        torch.testing.assert_close(found[name].cpu(), value, atol=1e-5, rtol=1e-4, msg=name)
