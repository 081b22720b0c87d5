"""Checkpoints that rsl_rl and mjlab make on the spot, in an environment of their own.

RSL_RL_PYTHON names a Python that has torch, rsl-rl-lib and mjlab; they cannot be installed beside hts, whose MuJoCo is
another. MADE_ELSEWHERE, if set, is a folder that keeps what they made for the next time: mjlab compiles for minutes.
"""

from __future__ import annotations

import os
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hts.contracts import RobotSpec
from hts.errors import PolicyError
from hts.policies.export import to_onnx, to_torchscript
from hts.policies.export_checks import check_export, random_observations
from hts.policies.importing import import_whole
from hts.policies.layout import Layout
from hts.policies.proof import ITEMS, NOT_PROVEN, PROVEN
from hts.policies.replay import replay
from hts.policies.replay_log import read_log

pytestmark = [pytest.mark.slow, pytest.mark.timeout(1500)]
LEGS = [f"{leg}_{part}_joint" for leg in ("FR", "FL", "RR", "RL") for part in ("hip", "thigh", "calf")]


def made(script: str, folder: Path) -> Path:
    """The folder that a script fills in the other environment."""
    keep = os.environ.get("MADE_ELSEWHERE")
    folder = Path(keep) / script.removesuffix(".py") if keep else folder
    if any(folder.glob("*.npz")):  # the last thing that a script writes
        return folder
    python = os.environ.get("RSL_RL_PYTHON")
    if not python:
        pytest.skip("RSL_RL_PYTHON names no Python with rsl-rl-lib and mjlab; they do not install beside hts")
    command = [python, str(Path(__file__).with_name(script)), str(folder)]
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False, timeout=1200)
    assert done.returncode == 0, done.stderr[-2000:]
    return folder


def a_robot(names=LEGS, **changes) -> RobotSpec:
    """One with gains, pose and scale of its own."""
    count = len(names)
    spec = RobotSpec(
        name="dog", joint_names=tuple(names), default_pose=(0.0,) * count, kp=(20.0,) * count, kd=(0.5,) * count,
        action_scale=(0.25,) * count, torque_limit=(40.0,) * count, velocity_limit=(30.0,) * count,
        position_limit=((-3.0, 3.0),) * count, control_rate_hz=50.0, physics_dt=0.005, substeps=4, base_height=0.3,
    )  # fmt: skip
    return replace(spec, **changes)


def test_a_checkpoint_of_rsl_rl_acts_as_it_does_there_and_so_do_its_exports(tmp_path):
    folder = made("made_by_rsl_rl.py", tmp_path / "run")
    spec = a_robot(["a", "b", "c", "d"])
    imported = import_whole(folder / "model_2.pt", spec)
    found = replay(folder / "model_2.pt", imported, read_log(folder / "pairs.npz"), spec)
    assert found["actions"].state == PROVEN and "300 actions" in found["actions"].why
    assert all(found[item].state == NOT_PROVEN for item in ITEMS if item != "actions")
    pairs = np.load(folder / "pairs.npz")
    for path, format in (
        (to_onnx(imported.policy, tmp_path / "walk.onnx"), "onnx"),
        (to_torchscript(imported.policy, tmp_path / "walk.pt"), "torchscript"),
    ):
        given = pairs["observation"].astype(np.float32)
        assert check_export(imported.policy, path, format, [random_observations(imported.policy), given]) < 1e-5


def test_a_checkpoint_of_mjlab_is_proven_by_a_walk_in_mjlab(tmp_path):
    folder = made("made_by_mjlab.py", tmp_path / "run")
    checkpoint = max(folder.glob("model_*.pt"))
    from hts.policies.contract import per_joint
    from hts.policies.params import source_beside

    said = source_beside(checkpoint).contract
    assert said.missing() == [] and said.joint_names == tuple(LEGS)  # from the ONNX file beside it
    gains = {key: per_joint(checkpoint, key, getattr(said, key), LEGS) for key in ("kp", "kd")}
    spec = a_robot(**gains)
    log = read_log(folder / "log.npz")
    imported = import_whole(checkpoint, spec, strict=True)
    found = replay(checkpoint, imported, log, spec)
    assert [item for item in ITEMS if found[item].state != PROVEN] == [], found
    swapped = (LEGS[1], LEGS[0], *LEGS[2:])
    wrong = import_whole(checkpoint, spec, Layout((), swapped), strict=True)
    with pytest.raises(PolicyError, match="joint_order is another"):
        replay(checkpoint, wrong, log, spec)
    exported = import_whole(folder / f"{folder.name}.onnx", spec)  # its numbers have three decimals
    actions = {"observation": log.observation, "action": log.action}
    np.savez(tmp_path / "actions.npz", **actions)
    alone = replay(folder / "run.onnx", exported, read_log(tmp_path / "actions.npz"), spec)
    assert [item for item in ITEMS if alone[item].state == PROVEN] == ["actions"]
