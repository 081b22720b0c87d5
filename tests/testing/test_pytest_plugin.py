"""The fixtures that plugin authors get with hts: what they give is known, and they cost nothing until they are used."""

from __future__ import annotations

import subprocess
import sys
from importlib.metadata import entry_points

import numpy as np
import pytest

from hts.config import EvaluationConfig, MeasurementConfig
from hts.plugins import load


def test_it_is_installed_with_hts_and_imports_nothing_heavy():
    (point,) = [point for point in entry_points(group="pytest11") if point.value == "hts.testing.pytest_plugin"]
    assert point.name == "hts"
    code = (
        "import sys, hts.testing.pytest_plugin\n"
        "print([n for n in ('torch', 'numpy', 'mujoco', 'pydantic', 'typer') if n in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_the_kit_is_offered_by_plugins_like_others(hts_kit):
    registry = load()
    found = {
        registry.robots["tiny"],
        registry.objectives["fake"],
        registry.selectors["plain"],
        registry.worlds["known"],
    }
    assert {entry.package for entry in found} == {"hard-to-sim-testing"}


def test_the_kit_is_not_offered_without_the_fixture():
    assert "tiny" not in load().robots


@pytest.fixture
def policy(hts_tiny_robot, tmp_path):
    from hts.policies.export import to_onnx
    from hts.policies.files import load_policy

    return to_onnx(load_policy(hts_tiny_robot.pretrained_policy(), hts_tiny_robot.spec), tmp_path / "policy.onnx")


@pytest.fixture
def other(hts_tiny_robot, tmp_path):
    """A policy with other numbers."""
    from dataclasses import replace

    from hts.policies.export import to_onnx
    from hts.policies.files import load_policy

    policy = load_policy(hts_tiny_robot.pretrained_policy(), hts_tiny_robot.spec)
    bias = policy.tensors["actor.1.bias"] + 0.01
    tensors, card = {**policy.tensors, "actor.1.bias": bias}, replace(policy.card, policy_hash="another")
    return to_onnx(type(policy)(tensors, card), tmp_path / "other.onnx")


def test_the_known_world_saves_exactly_what_it_says(hts_known_world, hts_fake_objective, policy, other):
    from hts.evaluation.final import head_to_heads

    recordings = hts_known_world.head_to_head(other, policy, (0.5, 0.8))
    results = head_to_heads(hts_fake_objective, recordings, EvaluationConfig(bootstrap=100))
    assert sorted(results) == [0.5, 0.8]
    for result in results.values():
        assert result.comparison.improvement == pytest.approx(0.2, abs=1e-5)
    same = head_to_heads(
        hts_fake_objective, hts_known_world.head_to_head(policy, policy, (0.8,)), EvaluationConfig(bootstrap=100)
    )
    assert same[0.8].comparison.improvement == pytest.approx(0.0, abs=1e-6)


def test_the_made_up_recordings_level_is_what_it_says(hts_known_world, policy):
    from hts.worlds.base import walking

    assert hts_known_world.idle() == {"fake_level": 5.0}
    (recording,) = hts_known_world.collect([policy], walking(0.8, 10.0))
    # 5 W idle and 10 W above it, times 1 + 0.3 tanh(x) with x symmetric about 0.
    assert recording.values("fake_level").mean() == pytest.approx(15.0, abs=0.5)
    assert recording.values("fake_level").min() > 5.0 + 10.0 * 0.7 - 1e-3
    assert np.allclose(recording.values("base_velocity"), [0.8, 0.0, 0.0])


def test_a_model_can_learn_the_known_world(hts_known_world, hts_fake_objective, policy):
    """Its channel follows the joints, so a few passes must explain something, and fewer parameters than samples do."""
    from hts.measurement.fit_command import fit_and_check
    from hts.worlds.base import walking

    recordings = hts_known_world.collect([policy] * 4, walking(0.8, 20.0))
    assert len({recording.values("joint_torque").tobytes() for recording in recordings}) == 4
    fitted = fit_and_check(hts_fake_objective, recordings, MeasurementConfig(epochs=12))
    assert fitted.report["held_out_r2"] > 0.2  # torque and speed are two of the four channels that it follows


def test_the_tiny_robot_drives_at_the_commanded_speed(hts_tiny_robot):
    from hts.config import EnvConfig
    from hts.evaluation.simulation import simulate, test_config
    from hts.policies.files import load_policy
    from hts.rl.population import Population

    policy = load_policy(hts_tiny_robot.pretrained_policy(), hts_tiny_robot.spec)
    speeds = (0.5, 0.8, 1.1)
    config = test_config(EnvConfig(), speeds, 4.0, seed=0)
    env = hts_tiny_robot.make_env("mujoco", 1, 6, config, channels=("base_velocity",), seeds=[0])
    (trials,) = simulate(env, Population.from_candidates(policy.card.sizes(), [policy.tensors]), speeds, 4.0, 0.1)
    env.close()
    for trial in trials:
        assert (trial.falls, trial.valid) == (0, 1.0)
        assert trial.mean_speed == pytest.approx(trial.speed, rel=0.06)


def test_the_fake_objectives_score_can_be_done_on_paper(hts_fake_objective):
    from hts.testing.made_up_recordings import known_segments

    segments = known_segments({hts_fake_objective.target: 8.0}, idle=5.0)
    scores = hts_fake_objective.score(segments)
    assert np.allclose(scores["net"], 3.0) and np.allclose(scores["gross"], 8.0)
    comparison = hts_fake_objective.compare({"net": 3.0, "gross": 8.0}, {"net": 6.0, "gross": 10.0})
    assert comparison.improvement == pytest.approx(0.5)
    assert comparison.metrics == {"gross_reduction": pytest.approx(0.2)}


def test_the_meters_reading_can_be_done_on_paper():
    from hts.contracts import PhysicsSample
    from hts.testing.examples.objective.meter import Meter, Settings

    meter = Meter(Settings(idle=5.0, loss=0.5, delay=0.1, noise=0.0))
    meter.reset(1, np.random.default_rng(0))
    still = np.zeros((1, 2))
    sample = PhysicsSample(np.array([[2.0, 0.0]]), np.array([[-3.0, 4.0]]), still, still, still, dt=0.01)
    meter.step(sample)
    # 5 + |2 · 3| + 0.5 · 2² = 13 W; a tenth of the way there after a tenth of the time constant: 5 + 0.8.
    assert meter.read() == {"fake_level": pytest.approx([5.8])}
    for _ in range(300):
        meter.step(sample)
    assert meter.read()["fake_level"] == pytest.approx([13.0])


def test_a_faulty_package_fails_the_check_with_its_line(hts_check, install):
    hts_check("hard-to-sim-testing")
    install("stranger", {"stranger": "import no_such_library"}, {"odd": "stranger"})
    with pytest.raises(pytest.fail.Exception, match="stranger: entry point 'odd': .*no_such_library") as caught:
        hts_check("stranger")
    assert "\n" not in str(caught.value)


def test_a_whole_run_ends_with_the_known_saving(hts_tiny_run):
    run = hts_tiny_run()
    assert [run.summary[key] for key in ("objectives", "robot", "world")] == [["fake"], "tiny", "known"]
    (speed,) = run.summary["final"]["objectives"]["fake"]["speeds"].values()
    assert speed["improvement"] == pytest.approx(0.2, abs=1e-5)
    assert (run.folder / "report.html").is_file()


def test_a_whole_run_takes_settings_and_says_what_is_wrong_with_them(hts_tiny_run):
    from hts.errors import ConfigError

    with pytest.raises(ConfigError, match="Did you mean 'saving'"):
        hts_tiny_run(settings={"world.savin": 0.5})
