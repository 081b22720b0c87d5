"""Files that cannot be imported as they are: what their owner is told."""

from __future__ import annotations

import pytest
import torch
from dog import SPEC

from hts.errors import PolicyError
from hts.policies.export_command import given_file
from hts.policies.importing import import_policy
from hts.policies.with_critic import critic_line


def test_an_onnx_file_that_is_not_there_is_said_to_be_missing(tmp_path):
    with pytest.raises(PolicyError, match=r"none.onnx: no such file\. Correct the path\.$"):
        import_policy(tmp_path / "none.onnx", SPEC)


@pytest.mark.parametrize("wrapped", [False, True])
def test_a_network_of_ones_own_in_a_pt_is_told_how_it_comes_in(tmp_path, wrapped):
    state = {"net.0.weight": torch.ones(2, 15), "net.0.bias": torch.ones(2), "mean": torch.zeros(15)}
    torch.save({"model_state_dict": state} if wrapped else state, tmp_path / "mine.pt")
    with pytest.raises(PolicyError, match=r"layer\.0\.weight.*'Your own code'"):
        import_policy(tmp_path / "mine.pt", SPEC)


def test_a_checkpoint_where_a_policy_of_ours_is_wanted_is_told_how_it_comes_in(tmp_path):
    (tmp_path / "model_3.pt").write_bytes(b"")
    with pytest.raises(PolicyError, match=r"ending in \.safetensors\. .*hts policy import .*model_3\.pt --robot NAME"):
        given_file(tmp_path / "model_3.pt", [".safetensors"])
    with pytest.raises(PolicyError, match=r"ending in \.safetensors\.$"):
        given_file(tmp_path / "none.pt", [".safetensors"])


def test_a_run_from_a_policy_without_a_critic_is_told_to_let_one_learn_first():
    assert "warmup_batches=20" in (critic_line({"critic": "new"}, 0) or "")
    assert critic_line({"critic": "new"}, 1) is None and critic_line({}, 0) is None
