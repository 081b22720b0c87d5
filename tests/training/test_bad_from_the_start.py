"""A measured reward that is no number for anybody before anybody has learned is no fault of the training."""

from __future__ import annotations

import math
from types import SimpleNamespace

import pytest
import torch

from hts.errors import SimulationError
from hts.training.trainer import PopulationTrainer


def looked_at(bad: list[tuple[int, int, int]], batches: int = 0) -> None:
    """bad: candidate, world and step that are NaN; of two candidates in three worlds over five steps."""
    real = torch.zeros(2, 3, 5)
    for place in bad:
        real[place] = math.nan
    PopulationTrainer._refuse_all_bad(SimpleNamespace(batches=batches), "calm", real)


def test_where_nobody_has_a_reward_from_the_start_the_objective_is_named_once_and_no_learning_rate():
    with pytest.raises(
        SimulationError, match="r_real of calm is not finite at control step 3, in all candidates"
    ) as told:
        looked_at([(0, 1, 4), (1, 2, 3)])
    said = str(told.value)
    assert "reward() of objective 'calm'" in said and "measurement model" in said
    assert "learning_rate" not in said and said.count("is not finite") == 1


def test_one_of_them_or_all_of_them_later_are_stopped_by_name():
    looked_at([(0, 1, 4)])
    looked_at([(0, 1, 4), (1, 2, 3)], batches=1)
