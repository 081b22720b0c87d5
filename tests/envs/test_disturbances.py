"""Pushes and pulls: who is pushed, what a pull does to a velocity, and that they go on over a stop."""

from __future__ import annotations

import pytest
import torch

from hts.config import RandomisationConfig
from hts.envs.disturbances import Disturbances

DT = 0.02


class Trunk:
    """Remembers what was done to its two worlds."""

    def __init__(self) -> None:
        self.device = torch.device("cpu")
        self.diverged = torch.zeros(2, dtype=torch.bool)
        self.velocity = torch.zeros(2, 2)
        self.pushed: list[list[bool]] = []

    def push(self, mask, velocity):
        self.pushed.append(mask.tolist())
        self.velocity += velocity * mask.unsqueeze(-1)

    def nudge(self, velocity):
        self.velocity += velocity


def disturbed(**config) -> tuple[Disturbances, Trunk]:
    trunk = Trunk()
    return Disturbances(RandomisationConfig(**config), (1, 2), DT, trunk), trunk


def draws(*rows: tuple[float, float, float]) -> torch.Tensor:
    return torch.tensor([rows])


def test_low_draws_push_and_no_world_whose_physics_broke():
    disturbances, trunk = disturbed(push_speed=0.5, push_interval=2.0)
    disturbances.act(draws((0.009, 1.0, 0.5), (0.011, 1.0, 0.5)))
    assert trunk.pushed == [[True, False]] and trunk.velocity.tolist() == [[0.5, 0.0], [0.0, 0.0]]
    trunk.diverged[0] = True
    disturbances.act(draws((0.0, 1.0, 0.5), (0.5, 1.0, 0.5)))
    assert len(trunk.pushed) == 1


def test_a_pull_stays_until_a_high_draw_and_adds_up():
    disturbances, trunk = disturbed(push_speed=0.0, pull=0.4, pull_seconds=2.0)
    disturbances.act(draws((0.995, 1.0, 0.0), (0.5, 1.0, 0.0)))
    for _ in range(49):
        disturbances.act(draws((0.5, 0.0, 0.0), (0.5, 0.0, 0.0)))
    assert trunk.velocity[0].tolist() == pytest.approx([0.4, -0.4]) and trunk.velocity[1].tolist() == [0.0, 0.0]
    disturbances.act(draws((0.995, 0.5, 0.5), (0.5, 0.0, 0.0)))
    assert disturbances.pull[0, 0].tolist() == [0.0, 0.0]


@pytest.mark.parametrize("config", [{"pull": 0.0, "push_speed": 0.0}, {"enabled": False, "pull": 0.4}])
def test_nothing_happens_where_nothing_is_asked_for(config):
    disturbances, trunk = disturbed(**config)
    disturbances.act(draws((0.999, 1.0, 1.0), (0.0, 1.0, 1.0)))
    assert not trunk.pushed and not trunk.velocity.any() and not disturbances.pull.any()


def test_several_pulls_are_dealt_out_to_the_instances_in_turn():
    disturbances, trunk = disturbed(push_speed=0.0, pull=(0.4, 0.0), pull_seconds=2.0)
    disturbances.act(draws((0.995, 1.0, 0.0), (0.995, 1.0, 0.0)))
    assert disturbances.pull[0].tolist() == [[pytest.approx(0.4), pytest.approx(-0.4)], [0.0, 0.0]]
    assert trunk.velocity[1].tolist() == [0.0, 0.0]


@pytest.mark.parametrize("pull", [-0.1, (0.2, -0.1), ()])
def test_a_pull_is_no_negative_number_and_a_list_of_them_not_empty(pull):
    with pytest.raises(ValueError, match="pull"):
        RandomisationConfig(pull=pull)
