"""Exploration noise inside an exported graph."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import onnxruntime
import pytest

from hts import plugins
from hts.policies.deploy import DeployedPolicy
from hts.policies.exploring import LARGEST_SEED, mean_of, seed_of, with_noise
from hts.policies.export import to_onnx
from hts.policies.files import Policy, load_policy

SIGMA = np.linspace(0.02, 0.2, 12)


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    """A policy that is to explore, as a run exports it: the noise is on the card."""
    policy = load_policy(plugins.load().make_robot("go1").pretrained_policy())
    card = dataclasses.replace(policy.card, exploration_std=tuple(SIGMA.tolist()))
    return to_onnx(Policy(policy.tensors, card), tmp_path_factory.mktemp("policy") / "walk.onnx")


def runs(content: bytes, observations: np.ndarray) -> dict[str, np.ndarray]:
    session = onnxruntime.InferenceSession(content, providers=["CPUExecutionProvider"])
    names = [one.name for one in session.get_outputs()]
    rows = [session.run(names, {"observation": row[None]}) for row in observations]
    return {name: np.concatenate([row[i] for row in rows]) for i, name in enumerate(names)}


@pytest.fixture(scope="module")
def observations():
    return np.random.default_rng(0).standard_normal((4000, 45)).astype(np.float32)


def test_a_runner_that_knows_nothing_of_noise_explores(exported, observations):
    plain = runs(exported.read_bytes(), observations)["action"]
    found = runs(with_noise(exported.read_bytes(), SIGMA, 7), observations)
    np.testing.assert_allclose(found["mean_action"], plain, atol=1e-6)
    unit = (found["action"] - found["mean_action"]) / SIGMA
    assert unit.mean(axis=0) == pytest.approx(0.0, abs=0.08)  # 5 standard errors of 4000
    assert unit.std(axis=0) == pytest.approx(1.0, abs=0.06)
    between = np.corrcoef(unit.T) - np.eye(12)
    in_time = np.mean(unit[1:] * unit[:-1], axis=0)
    assert np.abs(between).max() < 0.08
    assert np.abs(in_time).max() < 0.08


def test_a_seed_repeats_its_noise_and_another_does_not(exported, observations):
    few = observations[:50]
    first, again, other = (runs(with_noise(exported.read_bytes(), SIGMA, seed), few)["action"] for seed in (7, 7, 8))
    np.testing.assert_array_equal(first, again)
    assert np.abs(first - other).min() > 0


def test_seeds_are_whole_numbers_that_a_float32_holds():
    seeds = {seed_of("session", f"{number:02d}", "hash") for number in range(500)}
    assert len(seeds) == 500
    assert all(0 < seed < LARGEST_SEED and np.float32(seed) == seed for seed in seeds)


def test_noise_in_the_graph_is_not_added_again(exported, tmp_path):
    path = tmp_path / "noisy.onnx"
    path.write_bytes(with_noise(exported.read_bytes(), np.zeros(12), 7))  # its noise is nothing, so ours would show
    readings = {
        "angular_velocity": np.zeros((1, 3)),
        "projected_gravity": np.array([[0.0, 0.0, -1.0]]),
        "command": np.zeros((1, 3)),
        "joint_velocity": np.zeros((1, 12)),
    }
    noisy, mean = DeployedPolicy(path), tmp_path / "mean.onnx"
    mean.write_bytes(mean_of(exported.read_bytes()))
    pose = np.array([noisy.card.default_pose])
    for policy in (noisy, DeployedPolicy(mean)):
        policy.start(1, seed=3)
    expected = DeployedPolicy(mean).targets({**readings, "joint_position": pose})
    np.testing.assert_array_equal(noisy.targets({**readings, "joint_position": pose}), expected)
    loud = DeployedPolicy(exported)
    loud.start(1, seed=3)
    assert np.abs(loud.targets({**readings, "joint_position": pose}) - expected).max() > 1e-3


def test_the_card_says_where_the_noise_is(exported):
    import onnx

    model = onnx.load_from_string(with_noise(exported.read_bytes(), SIGMA, 7))
    props = {one.key: one.value for one in model.metadata_props}
    assert json.loads(props["hts_exploration"]) == {"where": "graph", "sigma": SIGMA.tolist(), "seed": 7}
    assert json.loads(props["hts"])["exploration_std"] == SIGMA.tolist()
    mean = {one.key: one.value for one in onnx.load_from_string(mean_of(exported.read_bytes())).metadata_props}
    assert json.loads(mean["hts"])["exploration_std"] == []
