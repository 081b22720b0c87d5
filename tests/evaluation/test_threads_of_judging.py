"""Who walks in simulation leaves the cores to physics: torch computes with one thread meanwhile."""

from __future__ import annotations

import pytest
import torch

from hts.config import EnvConfig, GateConfig, RandomisationConfig
from hts.evaluation.simulation import simulate, test_config
from hts.plugins import load
from hts.policies.files import load_policy
from hts.rl.population import Population
from hts.run.gate_trials import LostPackets, rollout

pytest.importorskip("hts_go1", reason="a robot with legs")
BASE = EnvConfig(threads=1, randomisation=RandomisationConfig(models=2))


@pytest.fixture
def robot():
    before = torch.get_num_threads()
    torch.set_num_threads(2)
    yield load().make_robot("go1")
    torch.set_num_threads(before)


def walker(robot):
    """An env of one policy in two instances, the policy, and where numbers of threads are noted."""
    shipped = load_policy(robot.pretrained_policy(), robot.spec)
    env = robot.make_env("mujoco", 1, 2, test_config(BASE, (0.8,), 3.0, seed=0), channels=("base_velocity",))
    return env, Population.from_candidates(shipped.card.sizes(), [shipped.tensors]), set[int]()


def test_in_the_judging_of_candidates(robot):
    env, population, threads = walker(robot)
    simulate(env, population, (0.8,), 3.0, 0.1, watch=lambda _: threads.add(torch.get_num_threads()))
    env.close()
    assert threads == {1} and torch.get_num_threads() == 2


def test_in_the_trials_of_the_gate(robot):
    env, population, threads = walker(robot)

    class Noting(LostPackets):
        def __call__(self, action):
            threads.add(torch.get_num_threads())
            return super().__call__(action)

    rollout(env, population, robot.spec, (), GateConfig(seconds=2.0), (0.8,), Noting((0.0, 0.0), 2, 0))
    env.close()
    assert threads == {1} and torch.get_num_threads() == 2
