"""`finetune.renew_noise`: every iteration's candidates begin with the pretrained policy's exploration noise."""

from __future__ import annotations

import json

import pytest
import torch

from hts.config_loading import read_config
from hts.plugins import load
from hts.policies.files import load_policy
from hts.run.job import Job
from hts.testing.packages import kit_installed
from hts.testing.tiny_run import tiny_run

ASKED = {"iterations": 2, "sweep.anchors": ["best"], "finetune.ppo.learning_rate": 1e-2}


@pytest.fixture(scope="module")
def renewed(tmp_path_factory):
    """The folder of a run."""
    return ran(tmp_path_factory.mktemp("renewed") / "run", True)


def ran(path, renewed):
    with kit_installed():
        return tiny_run(path, settings={**ASKED, "finetune.renew_noise": renewed}).folder


def second_iteration(path):
    """Rows of the second iteration's candidates, the sigma of the pretrained policy and of who was the best before."""
    best = json.loads((path / "summary.json").read_text())["iterations"][0]["best_so_far"]
    assert best != "pretrained", "nobody was better, so this run shows nothing"
    rows = json.loads((path / "iterations/01/finetune.json").read_text())["candidates"]
    files = (path / "policies/pretrained.safetensors", path / f"iterations/00/candidates/{best}.safetensors")
    pretrained, anchor = (float(load_policy(one).tensors["log_std"].exp().mean()) for one in files)
    return rows, pretrained, anchor


def test_an_anchor_has_the_noise_of_the_pretrained_policy_and_its_own_mean(renewed, tmp_path):
    rows, pretrained, before = second_iteration(renewed)
    assert before != pytest.approx(pretrained, rel=1e-6)
    assert all(row["anchor_std"] == pytest.approx(pretrained, rel=1e-6) for row in rows)
    own, own_pretrained, own_before = second_iteration(ran(tmp_path / "own", False))
    assert own_pretrained == pretrained and own_before == before  # the first iteration is the same
    assert all(row["anchor_std"] == pytest.approx(own_before, rel=1e-6) for row in own)
    assert [row["kl"] for row in rows] != [row["kl"] for row in own]


def test_the_mean_is_the_anchors_own(renewed):
    with kit_installed():
        job = Job(read_config(renewed / "config.yaml"), renewed, load(), None)
        name = json.loads((renewed / "summary.json").read_text())["iterations"][0]["best_so_far"]
        anchor, itself, first = job.anchor(name), job.policy(name), job.policy("pretrained")
    assert torch.equal(anchor.tensors["log_std"], first.tensors["log_std"])
    others = [key for key in itself.tensors if key != "log_std"]
    assert all(torch.equal(anchor.tensors[key], itself.tensors[key]) for key in others)
    assert anchor.card == itself.card
