"""An env that has no `random` is collected from as any other."""

from __future__ import annotations

import pytest
import torch
from walk_env import SHAPE, Walk

from hts.rl import CapturedCollector, GroupedEnv, Population, PopulationActor, PopulationCollector, Sizes

FRAMES = SHAPE.numel() * 5


class Ramp(Walk):
    """Its states are 1, 2, 3, ...; it says nothing of `random`."""

    steps = 0

    def __init__(self, shape: torch.Size = SHAPE) -> None:
        super().__init__(shape)
        del self.random

    def draw(self):
        self.steps += 1
        return torch.full((*self.batch_size, 3), float(self.steps))

    def _set_seed(self, seed):
        """Nothing is drawn."""


def batch(env, kind, **how):
    actor = PopulationActor(Population(Sizes(3, 3, 2, (4,)), SHAPE[0]))
    return next(iter(kind(env, actor, frames_per_batch=FRAMES, total_frames=FRAMES, **how))).clone()


def test_every_collector_takes_it():
    split = batch(Ramp(), PopulationCollector)
    assert split["next", "reward"][0, 0, :, 0].tolist() == [3.0, 6.0, 9.0, 12.0, 15.0]
    captured = batch(Ramp(), CapturedCollector, capture=False)
    for key in split.keys(True, True):
        assert torch.equal(captured[key], split[key]), key


def test_so_do_groups_unless_only_some_draw():
    one = torch.Size((1, SHAPE[1]))
    grouped = batch(GroupedEnv([Ramp(one), Ramp(one)]), CapturedCollector, capture=False)
    assert torch.equal(grouped["next", "reward"], batch(Ramp(), PopulationCollector)["next", "reward"])
    with pytest.raises(ValueError, match=r"^1 of 2 groups have generators of their own \(random\)"):
        GroupedEnv([Ramp(one), Walk(one)])
    assert len(GroupedEnv([Walk(one), Walk(one)]).random.generators) == 2
