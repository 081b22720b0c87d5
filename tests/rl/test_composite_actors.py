"""Actors made of several modules: one action is taken wherever it is written, several are refused."""

from __future__ import annotations

from functools import partial

import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import (
    CompositeDistribution,
    ProbabilisticTensorDictModule,
    ProbabilisticTensorDictSequential,
    TensorDictModule,
    set_composite_lp_aggregate,
)
from torch import nn
from torch.distributions import Categorical
from torchrl.modules import IndependentNormal, NormalParamExtractor, TanhNormal, ValueOperator
from torchrl.objectives import ClipPPOLoss

from hts.rl import KLConstrainedPPOLoss, project_actor_to_kl_bound


def head(*keys) -> TensorDictModule:
    return TensorDictModule(nn.Sequential(nn.Linear(3, 4), NormalParamExtractor()), ["observation"], list(keys))


def critic() -> ValueOperator:
    return ValueOperator(nn.Linear(3, 1), in_keys=["observation"])


def drawn(keys: list[str], writes: list[str], kind, **how) -> ProbabilisticTensorDictModule:
    return ProbabilisticTensorDictModule(keys, writes, distribution_class=kind, return_log_prob=True, **how)


def then_scaled() -> ProbabilisticTensorDictSequential:
    """An actor that does not end with its distribution: TensorDict makes a composite of it."""
    in_units = TensorDictModule(lambda action: 2 * action, ["action"], ["torque"])
    return ProbabilisticTensorDictSequential(
        head("loc", "scale"), drawn(["loc", "scale"], ["action"], TanhNormal), in_units
    )


def composite(*names: str, made=False) -> ProbabilisticTensorDictSequential:
    kinds = {name: IndependentNormal for name in names}
    how = {} if made else {"distribution_kwargs": {"distribution_map": kinds}}
    kind = partial(CompositeDistribution, distribution_map=kinds) if made else CompositeDistribution
    keys = [("params", names[0], "loc"), ("params", names[0], "scale")]
    return ProbabilisticTensorDictSequential(head(*keys), drawn(["params"], list(names), kind, **how))


@pytest.mark.filterwarnings("ignore:You are using a composite distribution:UserWarning")  # ClipPPOLoss, of one too
@pytest.mark.parametrize("aggregated", [False, True])
@pytest.mark.parametrize("make", [then_scaled, partial(composite, "turn"), partial(composite, "turn", made=True)])
def test_a_composite_of_one_action_is_that_action_as_in_clip_ppo(make, aggregated):
    torch.manual_seed(0)
    with set_composite_lp_aggregate(aggregated):
        actor, values = make(), critic()
        data = TensorDict({"observation": torch.randn(8, 3), "advantage": torch.randn(8, 1)}, [8])
        data["value_target"] = torch.randn(8, 1)
        loss = KLConstrainedPPOLoss(actor, values)
        with torch.no_grad():
            values(actor(data))
            actor[0].module[0].bias.add_(0.3)
        found = loss(data)
        stock = ClipPPOLoss(actor, values, entropy_bonus=False, loss_critic_type="l2", clip_value=0.2)(data)
        for key in ("loss_objective", "loss_critic"):
            torch.testing.assert_close(found[key], stock[key])
        assert float(found["kl"]) > 0.01
        project_actor_to_kl_bound(actor, loss.reference, data, 0.01)
        assert float(loss.kl_to_reference(data)) <= 0.01


def one_after_the_other() -> ProbabilisticTensorDictSequential:
    first = drawn(["loc", "scale"], ["speed"], IndependentNormal, log_prob_key="log_prob_of_speed")
    choice = TensorDictModule(nn.Linear(2, 4), ["speed"], ["logits"])
    last = drawn(["logits"], ["gait"], Categorical, log_prob_key="log_prob_of_gait")
    return ProbabilisticTensorDictSequential(head("loc", "scale"), first, choice, last)


@pytest.mark.parametrize(
    "make", [partial(composite, "speed", "gait"), partial(composite, "speed", "gait", made=True), one_after_the_other]
)
def test_several_actions_are_refused_by_their_names_when_the_loss_is_made(make):
    with pytest.raises(TypeError, match="^actor_network has several actions, '(speed', 'gait|gait', 'speed)'"):
        KLConstrainedPPOLoss(make(), critic())
