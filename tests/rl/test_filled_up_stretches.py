"""What TorchRL has filled stretches up with is no step: it is in no mean, as in TorchRL's own losses."""

from __future__ import annotations

import math
import re

import pytest
import torch
from tensordict import TensorDict
from test_loss_shapes import loss_and_batch
from torch.distributions import (
    AffineTransform,
    Beta,
    Independent,
    LogNormal,
    TransformedDistribution,
)
from torchrl.collectors.utils import split_trajectories
from torchrl.envs.utils import ExplorationType, set_exploration_type
from torchrl.objectives import ClipPPOLoss
from torchrl.objectives.value import GAE

from hts.rl import (
    KLConstrainedPPOLoss,
    MeasuredReward,
    Population,
    PopulationActor,
    PopulationCritic,
    RewardCentring,
    Sizes,
    project_actor_to_kl_bound,
)

MASK = ("collector", "mask")
PARTS = ("loss_objective", "loss_critic", "loss_entropy")
SAME = {"entropy_coeff": 0.01, "clip_value": None}


def filled_up(loss: KLConstrainedPPOLoss) -> TensorDict:
    """Episodes of four, two and six steps, as a collector with split_trajs=True gives them: [3, 6]."""
    data = TensorDict({"observation": torch.randn(2, 6, 3)}, [2, 6])
    with torch.no_grad():
        loss.actor_network(data)
    data["action_log_prob"] += 0.3 * torch.randn(2, 6)
    flags = {name: torch.zeros(2, 6, 1, dtype=torch.bool) for name in ("done", "terminated")}
    flags["done"][0, 3] = flags["terminated"][0, 3] = flags["done"][:, -1] = True
    outcome = {"observation": torch.randn(2, 6, 3), "reward": torch.randn(2, 6, 1), "effort": torch.randn(2, 6, 1)}
    data["next"] = TensorDict(outcome | flags, [2, 6])
    data["collector", "traj_ids"] = torch.tensor([[0] * 4 + [1] * 2, [2] * 6])
    return split_trajectories(data, trajectory_key=("collector", "traj_ids"))


def estimated(loss: KLConstrainedPPOLoss, shifted: bool = False) -> TensorDict:
    data = filled_up(loss)
    if shifted:
        data = data[2:].exclude(MASK)  # the whole stretch, with a mark of its own
        data["next", "done"][0, 2] = True
    data.names = [None, "time"]
    GAE(gamma=0.9, lmbda=0.9, value_network=loss.critic_network, shifted=shifted)(data)
    return data


@pytest.mark.parametrize("shifted", [False, True])
def test_the_loss_is_clip_ppos(shifted):
    loss = loss_and_batch(kl_bound=math.inf, **SAME)[0]
    data = estimated(loss, shifted)
    assert ("shifted_valid" in data) is shifted
    found, stock = loss(data), ClipPPOLoss(loss.actor_network, loss.critic_network, loss_critic_type="l2", **SAME)(data)
    for name in PARTS:
        torch.testing.assert_close(found[name], stock[name], msg=name)


@pytest.mark.parametrize("normalise", [False, True])
def test_it_is_that_of_the_steps_alone_and_so_is_the_kl(normalise):
    loss = loss_and_batch(normalize_advantage=normalise, **SAME)[0]
    data = estimated(loss)
    data["advantage"][~data[MASK]] = math.nan  # nobody looks
    with torch.no_grad():
        for parameter in loss.actor_network.parameters():
            parameter.add_(0.2 * torch.randn_like(parameter))
    steps = data[data[MASK]].exclude(MASK)
    found, alone = loss(data), loss(steps)
    for name in (*PARTS, "kl", "kl_approx", "clip_fraction"):
        torch.testing.assert_close(found[name], alone[name], msg=name)
    kl = loss.kl_to_reference(steps)
    torch.testing.assert_close(loss.kl_to_reference(data), kl)
    project_actor_to_kl_bound(loss.actor_network, loss.reference, data, float(kl) / 2)
    assert float(loss.kl_to_reference(steps)) == pytest.approx(float(kl) / 2, rel=0.01)


def test_a_mask_of_ones_own_is_named_or_none_is():
    loss = loss_and_batch(**SAME)[0]
    data = estimated(loss)
    masked = loss(data)
    data["mine"] = data.get(MASK)
    del data["collector"]
    assert not torch.equal(loss(data)["loss_critic"], masked["loss_critic"])
    loss.loss_mask_key = "mine"
    assert torch.equal(loss(data)["loss_critic"], masked["loss_critic"])
    for bad, said in ((data["mine"].float(), "torch.float32"), (torch.ones(3, 6, 2, dtype=torch.bool), "(3, 6, 2)")):
        with pytest.raises(ValueError, match=rf"^The mask 'mine' is .*{re.escape(said)}"):
            loss(data.set("mine", bad))


def test_of_candidates_each_has_its_own():
    population = Population(Sizes(3, 3, 2, (4,)), 2, seed=3)
    loss = KLConstrainedPPOLoss(
        PopulationActor(population), PopulationCritic(population), kl_bound=torch.ones(2), normalize_advantage=True
    )
    data = TensorDict({name: torch.randn(2, 8, 3) for name in ("observation", "critic_observation")}, [2, 8])
    with torch.no_grad():
        loss.critic_network(loss.actor_network(data))
    data["action"] += 0.5
    data["advantage"], data["value_target"] = torch.randn(2, 8, 1), torch.randn(2, 8, 1)
    data[MASK] = torch.arange(8).expand(2, -1) < 5
    found, alone = loss(data), loss(data[:, :5].exclude("collector"))
    for name in (*PARTS, "clip_fraction", "kl_approx"):
        torch.testing.assert_close(found[name], alone[name], msg=name)
    data[MASK][1] = False
    assert loss(data)["loss_critic"][1] == 0.0  # nothing to learn from, and no NaN
    assert loss.kl_to_reference(data).isnan().tolist() == [False, True]  # which the update of the multiplier tells


def test_a_batch_of_nothing_but_filling_is_told():
    loss = loss_and_batch(**SAME)[0]
    data = estimated(loss)
    data[MASK][:] = False
    for ask in (loss, loss.kl_to_reference, MeasuredReward(1.0, 0.1, in_key="effort")):
        with pytest.raises(ValueError, match=r"leave no step of the batch \(3, 6\) over"):
            ask(data)


@pytest.mark.parametrize("count", [None, 3])
def test_filling_is_not_paid_and_not_in_the_centre(count):
    data = filled_up(loss_and_batch()[0])
    mask, before = data[MASK].unsqueeze(-1), data["next", "reward"].clone()
    effort = data["next", "effort"]
    weight = 2.0 if count is None else torch.full((count,), 2.0)
    measured = MeasuredReward(weight, 0.1, in_key="effort", centring=RewardCentring(count=count))
    measured(data)
    rows = [effort[mask]] if count is None else [row[kept] for row, kept in zip(effort, mask, strict=True)]
    centre = torch.stack([row.mean() for row in rows])
    torch.testing.assert_close(measured.centring.mean.view(-1), centre)
    expected = torch.where(mask, before + 0.2 * (effort - centre.view(-1, 1, 1)), before)
    torch.testing.assert_close(data["next", "reward"], expected)


def from_one_to_four(loc, scale):
    return Independent(TransformedDistribution(Beta(1 + scale, 1 + loc.exp()), [AffineTransform(1.0, 3.0)]), 1)


@pytest.mark.parametrize("kind", [from_one_to_four, lambda loc, scale: Independent(LogNormal(loc, scale), 1)])
def test_zeros_that_a_policy_never_gives_spoil_no_gradient(kind):
    loss = loss_and_batch(kl_bound=math.inf, distribution=kind)[0]
    with set_exploration_type(ExplorationType.RANDOM):
        data = estimated(loss)
    assert not data["action"][~data[MASK]].any()
    weights = list(loss.actor_network.parameters())
    slopes = torch.autograd.grad(loss(data)["loss_objective"], weights)
    expected = torch.autograd.grad(loss(data[data[MASK]])["loss_objective"], weights)
    torch.testing.assert_close(slopes, expected)
