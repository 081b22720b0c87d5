"""The lines of docs/policies-from-elsewhere.md for a policy that leaves: around an ONNX file, and back to rsl_rl."""

from __future__ import annotations

import re
import runpy
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from dog import FOUR
from torch import nn

from hts.policies.contract import Contract
from hts.policies.export import to_onnx
from hts.policies.files import save_policy
from hts.policies.importing import import_whole
from hts.policies.layers import actions_of
from hts.policies.layout import Layout

PAGE = Path(__file__).resolve().parents[2] / "docs/policies-from-elsewhere.md"
NAMES, OTHER = FOUR.joint_names, ("FL_hip", "FR_hip", "FL_calf", "FR_calf")
SPEC = replace(FOUR, default_pose=(0.0, -1.8, 0.1, -1.7), action_scale=(0.25, 0.3, 0.35, 0.4))
POSE, SCALE = (0.1, -0.1, -1.5, -1.4), (0.125, 0.13, 0.26, 0.25)
SEEN = [
    ("command", [2.0, 2.0, 0.25]),
    ("angular_velocity", 0.25),
    ("joint_position_offset", 1.0),
    ("projected_gravity", 1.0),
    ("joint_velocity", 0.05),
    ("last_action", 0.5),
]


def lines(tmp_path, title: str) -> dict:
    (text,) = re.findall(rf'```python title="{title}"\n(.*?)```', PAGE.read_text(), re.DOTALL)
    (tmp_path / title).write_text(text)
    return runpy.run_path(str(tmp_path / title))


def net() -> nn.Sequential:
    torch.manual_seed(0)
    return nn.Sequential(nn.Linear(21, 8), nn.ELU(), nn.Linear(8, 6), nn.ELU(), nn.Linear(6, 4))


def checkpoint(folder, kind: str):
    """As rsl_rl 5, 3 and 2 save it: with a normaliser and log sigma, with one and sigma, without."""
    statistics = {"_mean": torch.randn(1, 21), "_std": torch.rand(1, 21), "count": torch.tensor(9)}
    layers, sigma = net().state_dict(), torch.tensor([0.1, 0.2, 0.3, 0.4])
    if kind == "5":
        state = {f"mlp.{name}": value for name, value in layers.items()}
        state |= {f"obs_normalizer.{name}": value for name, value in statistics.items()}
        saved = {"actor_state_dict": {**state, "distribution.log_std_param": sigma.log()}}
    else:
        state = {f"actor.{name}": value for name, value in layers.items()} | {"std": sigma}
        state["critic.0.weight"] = torch.zeros(1, 21)
        if kind == "3":
            state |= {f"actor_obs_normalizer.{name}": value for name, value in statistics.items()}
            state |= {f"critic_obs_normalizer.{name}": torch.zeros(1, 21) for name in ("_mean", "_std")}
        saved = {"model_state_dict": state}
    path = folder / "model_3.pt"
    torch.save({**saved, "iter": 3, "optimizer_state_dict": {}}, path)
    return path


def imported(path):
    sizes = {"command": 3, "angular_velocity": 3, "projected_gravity": 3}
    parts = tuple({"name": name, "size": sizes.get(name, 4), "scale": scale} for name, scale in SEEN)
    contract = Contract(OTHER, POSE, SCALE, SPEC.kp, SPEC.kd, 50.0, (0.0, 0.0))
    return import_whole(path, SPEC, Layout(parts, OTHER, contract))


@pytest.mark.parametrize("kind", ["5", "3", "2"])
def test_the_lines_back_into_rsl_rl_undo_an_import(tmp_path, kind):
    path = checkpoint(tmp_path, kind)
    save_policy(tmp_path / "mine.safetensors", imported(path).policy)
    before = torch.load(path, weights_only=True)
    blank = torch.load(path, weights_only=True)
    for name, value in (blank.get("actor_state_dict") or blank["model_state_dict"]).items():
        if "normalizer" not in name and "critic" not in name:
            value.zero_()  # nothing of the original's layers or sigma is left
    torch.save(blank, tmp_path / "blank.pt")
    back = lines(tmp_path, "to_rsl_rl.py")["to_rsl_rl"]
    back(str(tmp_path / "mine.safetensors"), tmp_path / "blank.pt", tmp_path / "back.pt", OTHER, POSE, SCALE, SEEN)
    after = torch.load(tmp_path / "back.pt", weights_only=True)
    torch.testing.assert_close(after, before, atol=1e-5, rtol=1e-5)


def test_the_lines_around_an_onnx_file_send_the_targets_that_hts_does(tmp_path):
    whole = imported(checkpoint(tmp_path, "5"))
    walker = lines(tmp_path, "walk.py")["Walker"](str(to_onnx(whole.policy, tmp_path / "walk.onnx")))
    assert tuple(walker.joints) == NAMES and walker.seconds == 0.02
    assert walker.kp.tolist() == list(SPEC.kp) and walker.kd.tolist() == list(SPEC.kd)
    rng, last = np.random.default_rng(0), np.zeros(4)
    for _ in range(5):
        rate, gravity, command = rng.normal(size=(3, 3))
        angles, speeds = rng.normal(size=(2, 4))
        observed = np.concatenate([rate, gravity, command, angles - np.array(SPEC.default_pose), speeds, last])
        last = actions_of(whole.policy.tensors, 3, torch.from_numpy(observed)[None])[0].numpy()
        sent = np.array(SPEC.default_pose) + np.array(SPEC.action_scale) * last
        np.testing.assert_allclose(walker.targets(rate, gravity, command, angles, speeds), sent, atol=1e-5)
