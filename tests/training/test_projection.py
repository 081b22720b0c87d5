"""The last step of a fine-tuning: who ended beyond its bound is moved inside, and nobody else is touched."""

from __future__ import annotations

import math

import pytest
import torch
from tensordict import TensorDict

from hts.errors import SimulationError
from hts.rl.kl_bound import mean_kl
from hts.rl.population import Population, Sizes
from hts.training.finetune import KL_SLACK, MOST_PROJECTIONS, Group
from hts.training.trainer import PopulationTrainer

SIZES = Sizes(4, 4, 2, (8,))
OBSERVED = torch.randn(1, 16, 8, 4, generator=torch.Generator().manual_seed(2))


class Trainer:
    """Only what the last step needs: the same observations for everybody, and the trainer's own way to stop one."""

    stop = PopulationTrainer.stop

    def __init__(self, population, anchor, broken):
        self.population, self.anchor, self.broken, self.batches = population, anchor, broken, 0
        self.names, self.stopped, self.steps = ["a", "b"], {}, self

    def halt(self, index):
        pass

    def collect(self):
        self.batches += 1
        observation = OBSERVED.expand(self.population.count, -1, -1, -1).clone()
        if self.batches == 1:
            observation[self.broken, 0, 0, 0] = float("nan")
        return TensorDict({"observation": observation}, batch_size=observation.shape[:3])


class Bare:
    device = torch.device("cpu")


def group(steps, bounds=None, broken=()):
    """Candidates so many steps from one anchor; without bounds, the first is 3 % beyond, in the slack."""
    start = Population(SIZES, 1, seed=0).candidate(0)
    population = Population.from_candidates(SIZES, [start] * len(steps))
    anchor = population.frozen()
    way = torch.randn(population.vectors[0].numel(), generator=torch.Generator().manual_seed(1)) * 0.05
    with torch.no_grad():
        for vector, step in zip(population.vectors, steps, strict=True):
            vector.add_(step * way)
    population.refresh()
    if bounds is None:
        bounds = [float(mean_kl(population, anchor, OBSERVED.flatten(1, 2).expand(len(steps), -1, -1))[0]) / 1.03]
        bounds *= len(steps)
    made = object.__new__(Group)
    made.population, made.anchor, made.bounds, made._extra, made.bare = (
        population,
        anchor,
        torch.tensor(bounds),
        0,
        Bare(),
    )
    made.trainer = Trainer(population, anchor, list(broken))
    return made


def test_a_candidate_inside_its_bound_stays_what_it_is_beside_one_that_is_not():
    alone, crowd = group([1.0]), group([1.0, 2.0])
    before = alone.population.vectors[0].clone()
    (kl,) = alone._project()
    kls = crowd._project()
    assert torch.equal(alone.population.vectors[0], before)
    assert torch.equal(crowd.population.vectors[0], before)
    assert kls[0] == pytest.approx(kl, rel=1e-6) and kls[0] > float(crowd.bounds[0])  # inside the slack of 5 %
    assert kls[1] <= KL_SLACK * float(crowd.bounds[1]) and not torch.equal(crowd.population.vectors[1], before)


def test_a_kl_that_is_not_finite_stops_that_candidate_and_moves_no_other():
    found = group([1.0, 0.5], broken=[1])
    before, start = found.population.vectors[0].clone(), found.anchor.vectors[1].clone()
    kls = found._project()
    assert found.trainer.stopped == {1: "candidate b: its KL to the anchor is not finite when training ends"}
    assert torch.equal(found.population.vectors[1], start) and kls[1] == 0.0
    assert torch.equal(found.population.vectors[0], before)
    assert found.trainer.batches == 1 < MOST_PROJECTIONS


def test_without_a_bound_it_is_named_too():
    found = group([1.0, 0.5], bounds=[math.inf, math.inf], broken=[0])
    kls = found._project()
    assert list(found.trainer.stopped) == [0] and kls[0] == 0.0 < kls[1] < math.inf


def test_of_the_last_candidate_it_ends_the_training():
    with pytest.raises(SimulationError, match="no candidate is left: candidate a: its KL to the anchor is not finite"):
        group([1.0], broken=[0])._project()
