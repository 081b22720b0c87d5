"""An env that changes in place what it said of an earlier step would give batches of wrong numbers; it is told."""

from __future__ import annotations

import pytest
from walk_env import CPU, Walk

from hts.rl import Population, PopulationActor, PopulationCollector, PopulationRandom, Sizes


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
