"""`hts export --measurement-model` of a run whose model is `drive_train`: reward and sensor, as its step has them."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path

import pytest
import torch

pytest.importorskip("hts_power", reason="the model of this test is not installed")
pytest.importorskip("hts_go1", reason="the robot of this test is not installed")

from hts.cli.main import main
from hts.config_loading import dump_config, load_config
from hts.contracts import ModelContext, robot_signals
from hts.measurement import files
from hts.measurement.pessimism import pessimistic_reward
from hts.plugins import load

INTEGRATION = Path(__file__).resolve().parents[3] / "integrations" / "rsl_rl"


@pytest.mark.parametrize("instant", [True, False])
def test_a_runs_last_model_is_exported_with_its_robots_joints(instant, tmp_path, monkeypatch, capsys):
    monkeypatch.syspath_prepend(str(INTEGRATION))
    registry, folder = load(), tmp_path / "run"
    robot, objective = registry.make_robot("go1"), registry.make_objective("power")
    signals, random = robot_signals(objective, robot), torch.Generator().manual_seed(0)
    for iteration in (0, 1):
        model = registry.make_measurement_model("drive_train", {"instant": instant}, ModelContext(signals))
        for numbers in (model.weight, model.doubt):  # as if fitted
            numbers.uniform_(0.0, 0.02, generator=random)
        model.sensor.copy_(torch.softmax(torch.randn(len(model.sensor), generator=random), 0))
        files.save(model, folder / "iterations" / f"{iteration:02d}" / "models" / "power")
    (folder / "config.yaml").write_text(dump_config(load_config(preset="smoke", objectives=["power"], robot="go1")))
    to = tmp_path / "cost.safetensors"
    assert main(["export", str(folder), "--measurement-model", "power", "--to", str(to)]) == 0
    assert main(["export", str(folder), "--measurement-model", "powder", "--to", str(tmp_path / "b.safetensors")]) == 2
    assert "Did you mean 'power'?" in capsys.readouterr().err

    read = importlib.import_module("hts_rsl_rl.measurement").MeasurementModel(to)
    assert read.joint_names == robot.spec.joint_names and read.target.unit == "A"
    state = shown = read.initial_state(5)
    memory = model.initial_state(5)
    for _ in range(70):  # longer than the sensor looks back
        inputs = torch.randn(5, 24, generator=random)
        (seen, state), (sensed, shown) = read.step(inputs, state), read.sensor(inputs, shown)
        stepped, memory = model.step(inputs, memory)
        wanted = model.settled(inputs) if instant else stepped
        torch.testing.assert_close(seen.measured, wanted.mean, atol=1e-5, rtol=1e-5)
        torch.testing.assert_close(sensed, stepped.mean, atol=1e-5, rtol=1e-5)
        reward = pessimistic_reward(objective.reward, wanted, model.pessimism)
        torch.testing.assert_close(seen.reward, reward, atol=1e-5, rtol=1e-5)
    assert torch.equal(state, read.initial_state(5)) is instant  # what settles keeps nothing
    for name in [name for name in sys.modules if name.split(".")[0] == "hts_rsl_rl"]:
        del sys.modules[name]
