"""A collector refuses, before its first step, what does not go together; flags of another shape with the first one."""

from __future__ import annotations

from functools import partial

import pytest
import torch
from tensordict.nn import TensorDictModule
from torch import nn
from walk_env import CPU, SHAPE, Walk

from hts.rl import Population, PopulationActor, PopulationCollector, PopulationRandom, Sizes
from hts.rl.captured_collector import CapturedCollector


class Flagged(Walk):
    """Says `flag` of each step's end."""

    def __init__(self, flag: torch.Tensor) -> None:
        super().__init__()
        self.flag = flag

    def end_step(self, action):
        return self.last, dict.fromkeys(("terminated", "truncated", "done"), self.flag)


def actor(candidates: int = 2, generators: int | None = None) -> PopulationActor:
    random = PopulationRandom(range(candidates if generators is None else generators), CPU)
    return PopulationActor(Population(Sizes(3, 3, 2, (8,)), candidates), random)


COLLECTORS = pytest.mark.parametrize(
    "kind", [PopulationCollector, partial(CapturedCollector, capture=False)], ids=["split", "captured"]
)


@COLLECTORS
def test_what_goes_together_is_collected(kind):
    collector = kind(Walk(), actor(), frames_per_batch=16)
    assert next(iter(collector)).shape == (*SHAPE, 2)
    part = kind(Walk(), actor(5).of(slice(1, 3)), frames_per_batch=16)
    part.shutdown()
    collector.shutdown()


@COLLECTORS
@pytest.mark.parametrize(
    ("policy", "found"),
    [
        (lambda: actor(3), "policy has 3 candidates, env 2"),
        (lambda: actor(2, 1), "random has 1 generators, expected one for each of the 2 candidates"),
    ],
)
def test_as_many_candidates_are_asked_for(kind, policy, found):
    with pytest.raises(ValueError, match=found):
        kind(Walk(), policy(), frames_per_batch=16)


@COLLECTORS
def test_a_policy_of_one_is_refused(kind):
    alone = TensorDictModule(nn.Linear(3, 2), in_keys=["observation"], out_keys=["action"])
    with pytest.raises(TypeError, match="policy is a TensorDictModule, expected a PopulationActor"):
        kind(Walk(), alone, frames_per_batch=16)


@COLLECTORS
@pytest.mark.parametrize("frames", [0, -8, 12])
def test_a_batch_is_whole_steps(kind, frames):
    with pytest.raises(ValueError, match=f"frames_per_batch is {frames}, expected a multiple of the 8"):
        kind(Walk(), actor(), frames_per_batch=frames)


@COLLECTORS
@pytest.mark.parametrize("flag", [torch.zeros(SHAPE, dtype=torch.bool), torch.zeros(*SHAPE, 1)])
def test_flags_of_another_shape_or_kind_are_told(kind, flag):
    collector = kind(Flagged(flag), actor(), frames_per_batch=16)
    with pytest.raises(
        ValueError, match=r"Flagged.end_step\(\) gave .* as terminated, expected \(2, 4, 1\) of torch.bool"
    ):
        next(iter(collector))
    collector.shutdown()
