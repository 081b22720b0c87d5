"""A script with the pieces of `hts.rl` is stopped and goes on from one file, as the page says."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from tensordict import TensorDict
from torchrl.checkpoint import Checkpoint
from torchrl.objectives.value import GAE
from walk_env import CPU, SHAPE, Walk

from hts.rl import (
    KLConstrainedPPOLoss,
    MeasuredReward,
    Population,
    PopulationActor,
    PopulationCollector,
    PopulationCritic,
    PopulationRandom,
    Sizes,
)

STEPS = 4


class Kept(Walk):
    """A walk that can be saved."""

    def full_state(self):
        return TensorDict({"state": self.state.clone(), "last": self.last.clone(), **self.random.state_dict()})

    def load_full_state(self, state):
        self.state, self.last = state["state"].clone(), state["last"].clone()
        self.random.load_state_dict({"generators": state["generators"]})


class Script:
    """What somebody's script makes, from a seed, and a batch of its training."""

    def __init__(self, seed: int) -> None:
        population = Population(Sizes(3, 3, 2, (8,)), SHAPE[0], seed=seed)
        env = Kept()
        env.set_seed(seed)
        actor, critic = (
            PopulationActor(population, PopulationRandom((seed, seed + 7), CPU)),
            PopulationCritic(population),
        )
        self.collector = PopulationCollector(env, actor, frames_per_batch=SHAPE.numel() * STEPS)
        self.loss = KLConstrainedPPOLoss(actor, critic, kl_bound=torch.tensor([1e-3, torch.inf]))
        self.optimiser = torch.optim.Adam(self.loss.parameters(), lr=1e-2)
        self.advantage = GAE(gamma=0.99, lmbda=0.95, value_network=critic, vectorized=False)
        self.measured = MeasuredReward(torch.tensor([1.0, 2.0]), 0.1, in_key="effort")

    @property
    def kept(self) -> Mapping[str, Any]:
        return {
            "loss": self.loss,
            "optimiser": self.optimiser,
            "collector": self.collector,
            "measured": self.measured,
        }

    def batch(self) -> TensorDict:
        data = self.collector.collect()
        data["next", "effort"] = -data["action"].square().sum(-1, keepdim=True)
        self.measured(data)
        self.advantage(data)
        for samples in data.flatten(1, 2).split(STEPS * 2, 1):
            parts = self.loss(samples)
            self.optimiser.zero_grad()
            (parts["loss_objective"] + parts["loss_critic"]).sum().backward()
            self.optimiser.step()
        self.loss.update_multiplier(self.loss.kl_to_reference(data))
        return data


def save(script: Script, path: Path) -> None:
    Checkpoint(format="archive", **script.kept).save(path)


def load(script: Script, path: Path) -> None:
    Checkpoint(format="archive", **script.kept).load(path)


def test_a_script_goes_on_from_one_file_as_if_it_had_never_been_stopped(tmp_path):
    script = Script(seed=1)
    for _ in range(3):
        script.batch()
    save(script, tmp_path / "training")
    multiplier = script.loss.multiplier.value.clone()
    expected = [script.batch() for _ in range(2)]
    another = Script(seed=50)
    load(another, tmp_path / "training")
    assert torch.equal(another.loss.multiplier.value, multiplier) and multiplier[0] > 0 == multiplier[1]
    for batch in expected:
        found = another.batch()
        for key in ("observation", "action", ("next", "reward"), "advantage"):
            assert torch.equal(found[key], batch[key]), key
    assert torch.equal(another.loss.kl_to_reference(expected[1]), script.loss.kl_to_reference(expected[1]))
