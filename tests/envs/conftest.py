"""Velocity envs of the Go1, for tests of them. Helpers are found beside the tests."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))


@pytest.fixture(scope="module")
def robot():
    from hts_go1.robot import Go1, Go1Settings

    return Go1(Go1Settings())


@pytest.fixture
def make(robot):
    """make(P, N, **EnvConfig) -> env; closed afterwards."""
    from stepping import CALM

    from hts.config import EnvConfig

    made = []

    def make(candidates=1, worlds=2, channels=(), seeds=None, **config):
        config = {"randomisation": CALM, "observation_noise": 0.0, "threads": 1, **config}
        env = robot.make_env("mujoco", candidates, worlds, EnvConfig(**config), channels, seeds)
        made.append(env)
        return env

    yield make
    for env in made:
        env.close()
