"""Checkpoints of rsl_rl with a slip in them: what the line says of it."""

from __future__ import annotations

import pytest
import torch
from dog import SPEC
from torch import nn

from hts.errors import PolicyError
from hts.policies.importing import import_policy


def saved(folder, inputs, std):
    net = nn.Sequential(nn.Linear(inputs, 8), nn.ELU(), nn.Linear(8, 2))
    state = {"std": torch.tensor(std), **{f"actor.{name}": value for name, value in net.state_dict().items()}}
    torch.save({"model_state_dict": state}, folder / "model.pt")
    return folder / "model.pt"


def test_a_checkpoint_with_a_sigma_of_zero_is_refused(tmp_path):
    with pytest.raises(PolicyError, match=r"its sigma of exploration \(std\) is 0 for an action"):
        import_policy(saved(tmp_path, 15, [0.3, 0.0]), SPEC)


def test_a_policy_that_sees_several_observations_at_once_is_told_what_it_is(tmp_path):
    with pytest.raises(PolicyError, match=r"75 = 5 x 15: a history of several observations\?"):
        import_policy(saved(tmp_path, 75, [0.3, 0.3]), SPEC)
