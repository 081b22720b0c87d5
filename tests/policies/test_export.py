"""Exported policies: ONNX and TorchScript against the population, and what drives a robot from them."""

from __future__ import annotations

import dataclasses
import json
import signal
import subprocess
import sys

import numpy as np
import onnxruntime
import pytest
import torch
from dog import UNEVEN as SPEC

from hts.envs.observation import observation_layout
from hts.errors import PolicyError, RunError
from hts.policies.deploy import DeployedPolicy
from hts.policies.export import to_onnx, to_torchscript
from hts.policies.export_checks import check_export, random_observations, recorded_observations
from hts.policies.export_command import export_policy
from hts.policies.files import Policy, make_card, save_policy
from hts.policies.onnx_metadata import read_metadata
from hts.rl.population import Population, Sizes

SIZES = Sizes(15, 21, 2, (16, 8))


def population() -> Population:
    made = Population(SIZES, 1, seed=2)
    generator = torch.Generator().manual_seed(2)
    with torch.no_grad():
        made.observation_mean += torch.randn(15, generator=generator)
        made.observation_std *= 0.2 + torch.rand(15, generator=generator)
        made.split(made.vectors[0])["actor.2.weight"].mul_(100.0)
    made.refresh()
    return made


@pytest.fixture(scope="module")
def policy() -> Policy:
    tensors = population().candidate(0)
    return Policy(tensors, make_card(SPEC, tensors, observation_layout(2), SIZES))


@pytest.fixture(scope="module")
def observations() -> torch.Tensor:
    return 4 * torch.randn(200, 15, generator=torch.Generator().manual_seed(1))


@pytest.fixture(scope="module")
def mean_actions(observations) -> np.ndarray:
    return population().mean(observations[None])[0].detach().numpy()


@pytest.fixture(scope="module")
def exported(policy, tmp_path_factory):
    return to_onnx(policy, tmp_path_factory.mktemp("export") / "deep" / "walk.onnx")


def test_onnx_gives_the_populations_mean_action(exported, observations, mean_actions):
    session = onnxruntime.InferenceSession(str(exported))
    assert [(x.name, x.type) for x in session.get_inputs()] == [("observation", "tensor(float)")]
    found = session.run(["action"], {"observation": observations.numpy()})[0]
    np.testing.assert_allclose(found, mean_actions, atol=1e-5, rtol=1e-5)
    assert np.abs(mean_actions).max() > 0.5  # it does act


def test_torchscript_gives_the_populations_mean_action(policy, observations, mean_actions, tmp_path):
    path = to_torchscript(policy, tmp_path / "new" / "walk.torchscript")
    extra = {"hts.json": ""}
    loaded = torch.jit.load(str(path), _extra_files=extra)
    np.testing.assert_allclose(loaded(observations).numpy(), mean_actions, atol=1e-5, rtol=1e-5)
    assert loaded(observations[:1]).shape == (1, 2)  # any batch, not the one it was traced with
    card = json.loads(extra["hts.json"])
    assert card["joint_names"] == ["left", "right"] and card["policy_hash"] == policy.card.policy_hash


def test_the_onnx_carries_all_that_a_robot_must_know(exported, policy):
    card = DeployedPolicy(exported).card
    assert (card.robot, card.joint_names, card.control_rate_hz) == ("dog", ["left", "right"], 50.0)
    assert (card.default_pose, card.action_scale) == ([0.1, -0.1], [0.25, 0.5])
    assert (card.kp, card.kd, card.history) == ([20.0, 20.0], [0.5, 0.5], 1)
    assert card.observation == observation_layout(2) and card.policy_hash == policy.card.policy_hash


def test_numbers_are_exported_in_full_precision(exported, policy):
    import onnx
    from onnx import numpy_helper

    arrays = {t.name: numpy_helper.to_array(t) for t in onnx.load(str(exported)).graph.initializer}
    for name, key in (("mean", "observation_mean"), ("std", "observation_std"), ("weight1", "actor.1.weight")):
        assert np.array_equal(arrays[name], policy.tensors[key].numpy()), name


def test_the_onnx_says_what_mjlabs_say_and_what_they_lack(exported, policy):
    meta = onnxruntime.InferenceSession(str(exported)).get_modelmeta().custom_metadata_map
    written_by_mjlab = {  # get_base_metadata of mjlab/rl/exporter_utils.py, 1.6
        "run_path", "joint_names", "joint_stiffness", "joint_damping", "default_joint_pos", "command_names",
        "observation_names", "observation_terms_scale", "observation_terms_flatten_history_dim",
        "observation_terms_history_length", "observation_terms_clip", "action_scale",
    }  # fmt: skip
    assert written_by_mjlab <= set(meta)
    assert meta["observation_names"] == "base_ang_vel,projected_gravity,command,joint_pos,joint_vel,actions"
    assert (meta["joint_names"], meta["action_scale"], meta["control_dt"]) == ("left,right", "0.25,0.5", "0.02")
    assert [float(one) for one in meta["action_sigma"].split(",")] == policy.tensors["log_std"].exp().tolist()
    assert "action_delay_seconds" not in meta  # its card does not say


def test_metadata_are_read_back_as_the_contract_they_were(policy, tmp_path):
    card = dataclasses.replace(policy.card, made={"delay_seconds": [0.0, 0.015]}, kp=(20.123456789, 20.0))
    source = read_metadata(to_onnx(Policy(policy.tensors, card), tmp_path / "walk.onnx"))
    contract = source.contract
    assert (contract.joint_names, contract.default_pose, contract.kp) == (SPEC.joint_names, (0.1, -0.1), card.kp)
    assert (contract.action_scale, contract.control_rate_hz) == ((0.25, 0.5), 50.0)
    assert contract.delay_seconds == (0.0, 0.015) and contract.missing() == []
    assert [(part["name"], part["size"]) for part in source.observation] == [
        (part["name"], part["size"]) for part in observation_layout(2)
    ]


def test_an_export_that_acts_otherwise_is_not_written(policy, tmp_path, monkeypatch):
    """A runtime that rounds, or a fault of ours: here other weights reach the file."""
    from hts.policies import export

    right = export.to_onnx

    def wrong(given, path, held):
        tensors = {**given.tensors, "actor.2.bias": given.tensors["actor.2.bias"] + 1e-4}
        return right(Policy(tensors, given.card), path)

    monkeypatch.setattr(export, "to_onnx", wrong)
    file = save_policy(tmp_path / "mine", policy)
    with pytest.raises(PolicyError, match="actions are off by up to 0.0001 on 512 observations"):
        export_policy(None, str(file), "onnx", tmp_path / "mine.onnx")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["mine.json", "mine.safetensors"]


WAITS = """
import signal, sys, time
signal.signal(signal.SIGINT, signal.default_int_handler)  # a suite in the background may ignore it, or a hang-up
signal.signal(signal.SIGHUP, signal.SIG_DFL)
from pathlib import Path
from hts.cli.main import main
from hts.policies import export

def slow(policy, path, held):
    Path(path).touch()
    print("ready", flush=True)
    time.sleep(60)

export.to_onnx = slow
sys.exit(main(["export", "--policy", sys.argv[1], "--to", sys.argv[2]]))
"""


@pytest.mark.parametrize(
    ("number", "said"),
    [(signal.SIGTERM, "stopped by SIGTERM\n"), (signal.SIGHUP, "stopped by SIGHUP\n"), (signal.SIGINT, "")],
)
def test_an_export_that_is_told_to_end_leaves_nothing_behind(policy, tmp_path, number, said):
    file, place = save_policy(tmp_path / "mine", policy), tmp_path / "out"
    begun = [sys.executable, "-c", WAITS, str(file), str(place / "mine.onnx")]
    command = subprocess.Popen(begun, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert command.stdout.readline() == "ready\n"
    assert [path.name for path in place.glob(".export-*/*")] == ["mine.onnx"]
    command.send_signal(number)
    _, err = command.communicate(timeout=300)
    assert (command.returncode, err, list(place.iterdir())) == (128 + number, said, [])


def test_a_policy_whose_weights_cancel_is_told_so_and_no_fault_of_ours(policy, tmp_path):
    """1e5 h + a - 1e5 h in the last layer: 32 bits leave two digits of a after the point."""
    tensors = {key: value.clone() for key, value in policy.tensors.items()}
    tensors["actor.1.weight"][1], tensors["actor.1.bias"][1] = tensors["actor.1.weight"][0], 1.0
    tensors["actor.1.bias"][0] = 1.0
    tensors["actor.2.weight"][:, :2] += torch.tensor([1e5, -1e5])
    file = save_policy(tmp_path / "mine", Policy(tensors, make_card(SPEC, tensors, observation_layout(2), SIZES)))
    with pytest.raises(PolicyError, match=r"for 32 bits alone: weights of up to 1e\+05 in 'actor.2.weight' cancel"):
        export_policy(None, str(file), "onnx", tmp_path / "mine.onnx")


@pytest.mark.parametrize("format", ["onnx", "torchscript"])
def test_exports_act_as_the_policy_on_random_and_recorded_observations(policy, tmp_path, format):
    from hts.channels import standard_channels
    from hts.recordings import RecordingStore
    from hts.recordings.recording import Series
    from hts.testing.made_up_recordings import known_recording

    rng, rows = np.random.default_rng(0), 120
    shapes = {name: channel for name, channel in standard_channels(2, 2).items() if name != "joint_torque"}
    made_up = {name: Series(one, rng.normal(size=(rows, *one.shape))) for name, one in shapes.items()}
    down = made_up["projected_gravity"].values
    made_up["projected_gravity"] = Series(
        shapes["projected_gravity"], down / np.linalg.norm(down, axis=1, keepdims=True)
    )
    base = known_recording([8.0] * 1)
    recording = base.replace(
        robot="dog", joint_names=SPEC.joint_names, kp=SPEC.kp, kd=SPEC.kd, rate_hz=50.0, time=np.arange(rows) / 50,
        channels=made_up, idle={},
    )  # fmt: skip
    store = RecordingStore(tmp_path / "data.zarr", create=True)
    store.write(recording)
    recorded = recorded_observations(policy, tmp_path / "data.zarr")
    assert recorded.shape == (rows, 15)
    np.testing.assert_allclose(
        recorded[1:, 13:], (made_up["joint_target"].values[:-1] - [0.1, -0.1]) / [0.25, 0.5], 1e-4
    )
    path = (to_onnx if format == "onnx" else to_torchscript)(policy, tmp_path / f"walk.{format}")
    assert check_export(policy, path, format, [random_observations(policy), recorded]) < 1e-5


def readings(robots: int, seed: int = 0) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(seed)
    sizes = {"angular_velocity": 3, "projected_gravity": 3, "command": 3, "joint_position": 2, "joint_velocity": 2}
    return {name: rng.normal(size=(robots, size)) for name, size in sizes.items()}


def observed(given: dict[str, np.ndarray], last: np.ndarray) -> torch.Tensor:
    parts = [given["angular_velocity"], given["projected_gravity"], given["command"]]
    parts += [given["joint_position"] - np.array([0.1, -0.1]), given["joint_velocity"], last]
    return torch.tensor(np.concatenate(parts, 1), dtype=torch.float32)


def test_targets_are_default_pose_plus_scaled_action_and_the_action_is_seen_in_the_next_step(exported):
    deployed, last = DeployedPolicy(exported), np.zeros((3, 2))
    deployed.start(3)
    for step in range(3):
        given = readings(3, step)
        action = population().mean(observed(given, last)[None])[0].detach().numpy()
        np.testing.assert_allclose(deployed.targets(given), [0.1, -0.1] + np.array([0.25, 0.5]) * action, atol=1e-5)
        last = action


def test_reset_forgets_the_past_of_the_robots_of_the_mask(exported):
    deployed, fresh = DeployedPolicy(exported), DeployedPolicy(exported)
    for each in (deployed, fresh):
        each.start(2)
    first = deployed.targets(readings(2, 0))
    deployed.reset(np.array([True, False]))
    after, new = deployed.targets(readings(2, 1)), fresh.targets(readings(2, 1))
    np.testing.assert_array_equal(after[0], new[0])
    assert not np.array_equal(after[1], new[1])
    deployed.start(2)
    np.testing.assert_array_equal(deployed.targets(readings(2, 0)), first)


def test_a_policy_with_history_sees_its_observations_stacked_newest_last(tmp_path):
    sizes = Sizes(30, 21, 2, (4,))
    stacked = Population(sizes, 1, seed=1)
    with torch.no_grad():
        stacked.split(stacked.vectors[0])["actor.1.weight"].mul_(100.0)
    stacked.refresh()
    tensors = stacked.candidate(0)
    card = dataclasses.replace(make_card(SPEC, tensors, observation_layout(2), sizes), history=2)
    deployed = DeployedPolicy(to_onnx(Policy(tensors, card), tmp_path / "past.onnx"))
    past, last = torch.zeros(1, 15), np.zeros((1, 2))
    for step in range(3):
        given = readings(1, step)
        now = observed(given, last)
        action = stacked.mean(torch.cat((past, now), 1)[None])[0].detach().numpy()
        np.testing.assert_allclose(deployed.targets(given), [0.1, -0.1] + np.array([0.25, 0.5]) * action, atol=1e-5)
        past, last = now, action


@pytest.mark.parametrize("content", [b"", b"nothing of the kind", None])
def test_a_file_that_is_no_exported_policy_is_one_line(tmp_path, content):
    path = tmp_path / "walk.onnx"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(PolicyError, match="walk.onnx: not an exported policy"):
        DeployedPolicy(path)


def test_an_onnx_from_elsewhere_is_refused(exported, tmp_path):
    import onnx

    model = onnx.load(str(exported))
    del model.metadata_props[:]
    onnx.save(model, str(tmp_path / "other.onnx"))
    with pytest.raises(PolicyError, match="not an exported policy"):
        DeployedPolicy(tmp_path / "other.onnx")


def test_a_policy_of_a_run_is_exported_by_name_and_nothing_is_overwritten(policy, tmp_path):
    save_policy(tmp_path / "run" / "policies" / "best", policy)
    target = tmp_path / "best.onnx"
    assert export_policy(tmp_path / "run", "best", "onnx", target) == target
    assert DeployedPolicy(target).card.policy_hash == policy.card.policy_hash
    with pytest.raises(RunError, match="exists already"):
        export_policy(tmp_path / "run", "best", "onnx", target)
    with pytest.raises(PolicyError, match="No policy named 'bst'. Did you mean 'best'?"):
        export_policy(tmp_path / "run", "bst", "onnx", tmp_path / "other.onnx")


def test_a_policy_file_that_belongs_to_no_run_is_exported_for_its_own_robot_only(policy, tmp_path):
    file = save_policy(tmp_path / "mine", policy)
    target = export_policy(None, str(file), "onnx", tmp_path / "mine.onnx", robot=SPEC)
    assert DeployedPolicy(target).card.policy_hash == policy.card.policy_hash
    with pytest.raises(PolicyError, match="other"):
        export_policy(None, str(file), "onnx", tmp_path / "new.onnx", robot=dataclasses.replace(SPEC, name="other"))
    for wrong in ("best", str(target), str(tmp_path / "nothing.safetensors")):
        with pytest.raises(PolicyError, match="expected a policy file that exists, ending in .safetensors"):
            export_policy(None, wrong, "onnx", tmp_path / "new.onnx")
    assert not (tmp_path / "new.onnx").exists()
