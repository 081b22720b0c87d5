"""An env that changes in place what it said of an earlier step would give batches of wrong numbers; it is told."""

from __future__ import annotations

import pytest
import torch
from torchrl.data import Binary, Composite, Unbounded

from hts.rl import Population, PopulationActor, PopulationCollector, PopulationRandom, Sizes, SplitStepEnv

CPU, SHAPE = torch.device("cpu"), torch.Size((2, 4))


class Walk(SplitStepEnv):
    """States [P, N, 3] drawn anew; a step pays the sum of the one it began in; episodes never end."""

    dt = 1.0

    def __init__(self) -> None:
        super().__init__(batch_size=SHAPE, device=CPU)
        self.random = PopulationRandom(range(SHAPE[0]), CPU)
        self.state = self.draw()
        self.last = torch.zeros_like(self.state)
        seen = {name: Unbounded((*SHAPE, 3)) for name in ("observation", "critic_observation")}
        self.observation_spec = Composite(**seen, shape=SHAPE)
        self.action_spec, self.reward_spec = Unbounded((*SHAPE, 2)), Unbounded((*SHAPE, 1))
        flag = Binary(1, (*SHAPE, 1), dtype=torch.bool)
        self.done_spec = Composite({name: flag.clone() for name in ("done", "terminated", "truncated")}, shape=SHAPE)

    def draw(self) -> torch.Tensor:
        return self.random.uniform(SHAPE[1], 3)

    def begin_step(self, action):
        return action

    def simulate(self, inputs):
        self.last, self.state = self.state, self.draw()

    def end_step(self, action):
        never = torch.zeros(*SHAPE, 1, dtype=torch.bool)
        return self.last, {"terminated": never, "truncated": never, "done": never}

    def rewards(self, steps):
        return torch.stack(list(steps)).sum(-1)

    def observations(self):
        return {"observation": self.state, "critic_observation": self.state}

    def channel_values(self):
        return {}

    def start_episodes(self, mask):
        """None ends."""

    def _set_seed(self, seed):
        self.random.seed(seed or 0)


def first_batch(env: Walk, horizon: int = 6):
    count, instances = env.batch_size
    population = Population(Sizes(3, 3, 2, (8,)), count, init_std=0.5, seed=1)
    actor = PopulationActor(population, PopulationRandom(range(count), CPU))
    collector = PopulationCollector(env, actor, frames_per_batch=count * instances * horizon)
    try:
        return next(iter(collector))
    finally:
        collector.shutdown()


class SeenInPlace(Walk):
    """Gives its own state as what is observed, and changes it."""

    def simulate(self, inputs):
        self.last = self.state.clone()
        self.state.copy_(self.draw())


class RewardedInPlace(Walk):
    """Keeps what rewards are made of in memory of its own."""

    def simulate(self, inputs):
        self.last.copy_(self.state)
        self.state = self.draw()


class RewardedByCount(Walk):
    """Rewards that depend on how many steps are asked about."""

    def rewards(self, steps):
        return super().rewards(steps) / len(steps)


def test_an_env_that_gives_new_tensors_is_collected_from():
    assert first_batch(Walk())["next", "reward"].isfinite().all()


def test_observations_that_are_changed_in_place_are_told():
    with pytest.raises(RuntimeError, match=r"SeenInPlace changes observation, critic_observation.* of a step in place"):
        first_batch(SeenInPlace())


@pytest.mark.parametrize("env", [RewardedInPlace, RewardedByCount])
def test_rewards_that_later_steps_change_are_told(env):
    with pytest.raises(RuntimeError, match=f"{env.__name__} gives other rewards for a step once later steps"):
        first_batch(env())


@pytest.mark.parametrize("env", [RewardedInPlace, RewardedByCount])
def test_a_batch_of_one_step_cannot_be_wrong(env):
    assert first_batch(env(), horizon=1)["next", "reward"].isfinite().all()
