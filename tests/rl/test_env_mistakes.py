"""What an env says wrongly is told with its name in the first batch, and a memory that it has yet to make is gone on
from."""

from __future__ import annotations

from functools import partial

import pytest
import torch
from tensordict import TensorDict
from torchrl.data import Unbounded
from torchrl.envs import TransformedEnv
from walk_env import SHAPE, Walk

from hts.rl import CapturedCollector, DeferrableTransform, Population, PopulationActor, PopulationCollector, Sizes

COLLECTORS = pytest.mark.parametrize(
    "kind", [PopulationCollector, partial(CapturedCollector, capture=False)], ids=["split", "captured"]
)


class Paid(Walk):
    """rewards() as `made` of what it should be, [T, P, N]."""

    def __init__(self, made) -> None:
        super().__init__()
        self.made = made

    def rewards(self, steps):
        return self.made(super().rewards(steps))


class Seen(Walk):
    """observations() as `made` of what they should be."""

    def __init__(self, made) -> None:
        super().__init__()
        self.made = made

    def observations(self):
        return self.made(super().observations())


class Sum(DeferrableTransform):
    """What was paid so far: a memory that is made with the first step, as `prepare` says."""

    def __init__(self) -> None:
        super().__init__(in_keys=["channels"], out_keys=["sum"])
        self.register_buffer("paid", None)

    def prepare(self, instances, device):
        if self.paid is None:
            self.paid = torch.zeros(instances, 1, device=device)

    def record(self, channels):
        return channels["level"].reshape(-1, 1)

    def evaluate(self, recorded):
        self.paid = self.paid + recorded
        return {"sum": self.paid}

    def forget(self, ended):
        """Nothing."""

    def transform_observation_spec(self, observation_spec):
        observation_spec["sum"] = Unbounded((*SHAPE, 1))
        return observation_spec


class Kept(Walk):
    def channel_values(self):
        return {"level": self.state.sum(-1)}

    def full_state(self):
        return TensorDict({"state": self.state.clone(), "last": self.last.clone(), **self.random.state_dict()})

    def load_full_state(self, state):
        self.state, self.last = state["state"].clone(), state["last"].clone()
        self.random.load_state_dict({"generators": state["generators"]})


def collected(env, kind=PopulationCollector):
    actor = PopulationActor(Population(Sizes(3, 3, 2, (8,)), SHAPE[0]))
    return kind(env, actor, frames_per_batch=SHAPE.numel() * 2)


@COLLECTORS
@pytest.mark.parametrize(
    ("made", "found"),
    [
        (lambda rewards: rewards.movedim(0, -1), r"\(2, 4, \d\)"),  # as many numbers, of other steps
        (lambda rewards: rewards[0], r"\(2, 4\)"),
        (lambda rewards: rewards.unsqueeze(-1), r"\(\d, 2, 4, 1\)"),
        (lambda rewards: rewards.numpy(), "a ndarray"),
    ],
)
def test_rewards_in_another_order_of_dimensions_are_told(kind, made, found):
    with pytest.raises(ValueError, match=rf"^Paid.rewards\(\) gave {found} for \d steps?, expected a tensor"):
        collected(Paid(made), kind).collect()


@COLLECTORS
@pytest.mark.parametrize(
    ("made", "found"),
    [
        (lambda seen: {"obs": seen["observation"]}, r"only \['obs'\]"),
        (lambda seen: {key: one.double() for key, one in seen.items()}, r"\(2, 4, 3\) of torch.float64"),
        (lambda seen: {key: one[..., :2] for key, one in seen.items()}, r"\(2, 4, 2\) of torch.float32"),
    ],
)
def test_observations_that_the_policy_cannot_read_are_told(kind, made, found):
    said = rf"^Seen.observations\(\) gave {found} as observation, expected \(2, 4, 3\) of torch.float32"
    with pytest.raises(ValueError, match=said):
        collected(Seen(made), kind).collect()


@pytest.mark.parametrize("batches", [0, 1])
def test_a_transforms_memory_that_is_not_made_yet_is_gone_on_from(batches):
    first = collected(TransformedEnv(Kept(), Sum(), auto_unwrap=False))
    for _ in range(batches):
        first.collect()
    state = first.state_dict()
    expected = first.collect()["next", "sum"]
    second = collected(TransformedEnv(Kept(), Sum(), auto_unwrap=False))
    second.load_state_dict(state)
    assert torch.equal(second.collect()["next", "sum"], expected)


def test_an_env_that_cannot_say_where_it_is_is_told_what_to_write():
    with pytest.raises(RuntimeError, match=r"^Walk cannot be saved .* Write full_state\(\) and load_full_state\(\)"):
        collected(Walk()).state_dict()
