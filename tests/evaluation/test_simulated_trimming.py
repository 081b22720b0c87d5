"""Which envs can be told other speeds while they run, so that a speed can be held in simulation."""

from __future__ import annotations

import pytest
import torch

from hts.envs.commands import WalksAsTold
from hts.errors import ConfigError
from hts.evaluation.simulated_trimming import told
from hts.rl.task_env import SplitStepEnv


def nothing(self, *given):
    """Nobody steps it."""


Parts = type(
    "Parts",
    (SplitStepEnv,),
    {name: nothing for name in SplitStepEnv.__abstractmethods__} | {"groups": lambda self: self.made_of},
)
"""Made up of others, or of nothing."""


class Walker(WalksAsTold):
    def __init__(self, count):
        self.batch_size = torch.Size((count, 3))

    def walk_at(self, commands):
        self.told = commands


def parts(*made_of):
    env = object.__new__(Parts)
    vars(env)["made_of"] = made_of
    return env


def test_each_group_is_told_its_own_part():
    first, second = Walker(2), Walker(1)
    told(parts(first, second)).walk_at(torch.arange(9.0).reshape(3, 3))
    assert first.told.tolist() == [[0.0, 1.0, 2.0], [3.0, 4.0, 5.0]] and second.told.tolist() == [[6.0, 7.0, 8.0]]


@pytest.mark.parametrize("made_of", [(), (object(),), (Walker(2), object()), (object(), Walker(2))])
def test_an_env_of_which_a_part_takes_no_speed_is_refused(made_of):
    with pytest.raises(ConfigError, match=r"The env of this robot \(Parts\) takes no other speed while it runs"):
        told(parts(*made_of))
