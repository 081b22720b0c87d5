"""What an env says wrongly is told with its name in the first batch."""

from __future__ import annotations

from functools import partial

import pytest
import torch
from walk_env import SHAPE, Walk

from hts.rl import CapturedCollector, Population, PopulationActor, PopulationCollector, Sizes

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
