"""Files that cannot be imported as they are: what their owner is told."""

from __future__ import annotations

import pytest
import torch
from dog import SPEC

from hts.errors import PolicyError
from hts.policies.importing import import_policy


def test_an_onnx_file_that_is_not_there_is_said_to_be_missing(tmp_path):
    with pytest.raises(PolicyError, match=r"none.onnx: no such file\. Correct the path\.$"):
        import_policy(tmp_path / "none.onnx", SPEC)


@pytest.mark.parametrize("wrapped", [False, True])
def test_a_network_of_ones_own_in_a_pt_is_told_how_it_comes_in(tmp_path, wrapped):
    state = {"net.0.weight": torch.ones(2, 15), "net.0.bias": torch.ones(2), "mean": torch.zeros(15)}
    torch.save({"model_state_dict": state} if wrapped else state, tmp_path / "mine.pt")
    with pytest.raises(PolicyError, match=r"layer\.0\.weight.*'Your own code'"):
        import_policy(tmp_path / "mine.pt", SPEC)
