"""An oracle of the reward alone: `hts run`, with a reality's own instruments in the place of the fitted model."""

from __future__ import annotations

import json

import numpy as np
import pytest
import torch

from hts.cli.main import main
from hts.errors import UnfitWorldError
from hts.worlds.oracle import IN_SIMULATION
from hts.worlds.oracle.robot import OracleRobot
from hts.worlds.oracle.simulated import ExactMeasurement, SimulatedInstruments, check_exact

pytest.importorskip("hts_power", reason="its gauge knows the exact current")
WORLD = {"reality": "dev-03"}
OF_POWER = ["--objective", "power", "--robot", "go1", "--preset", "smoke"]
TINY = [
    *(*OF_POWER, "--in-simulation", "--set", "finetune.steps=48", "--set", "world.reality=dev-03"),
    *("--set", "finetune.num_envs=4", "--set", "finetune.ppo.horizon=12", "--set", "gate.enabled=false"),
    *("--set", "simulation_test.num_envs=2", "--set", "simulation_test.seconds=3", "--set", "world.block_seconds=3"),
    *("--set", "sweep.kl_bounds=[1.0]", "--set", "sweep.trust_region.enabled=true"),
]


class Fitted:
    """All that an exact measurement asks of the model whose place it takes."""

    target_mean, target_std = torch.tensor(5.0), torch.tensor(2.0)


@pytest.fixture
def spec(registry):
    return registry.make_robot("go1").spec


@pytest.fixture
def make(registry):
    return OracleRobot(registry.make_robot("go1"), WORLD, {"power": {}}, registry).instruments


def recorded(worlds: int, seed: int = 0) -> torch.Tensor:
    random = torch.Generator().manual_seed(seed)
    scale = torch.tensor([5.0] * 12 + [4.0] * 12 + [40.0] * 4)
    return scale * torch.randn(worlds, 28, generator=random)


def test_what_is_seen_is_what_the_bus_gave_at_those_torques_and_speeds(spec, make):
    seen = SimulatedInstruments(make, spec, 3)
    gauge = make()["battery_gauge"]
    gauge.reset(3, np.random.default_rng(0))
    before = np.zeros(3)
    for step in range(5):
        row = recorded(3, step)
        told = seen.see(row)
        gauge._torque[0], gauge._speed[0] = row[:, :12].numpy(), row[:, 12:24].numpy()
        gauge._count, gauge._dt = 1, 0.02
        gauge.read()
        spent = gauge.energy["bus"].copy()
        watts = told["battery_current"] * told["battery_voltage"]
        np.testing.assert_allclose(watts, (spent - before) / 0.02, rtol=1e-9)
        before = spent


def test_it_stands_for_the_model_in_the_models_own_scale(registry, spec, make):
    power = registry.make_objective("power")
    exact = ExactMeasurement(power, Fitted(), make, spec)
    plain = SimulatedInstruments(make, spec, 2)
    steps = torch.stack([recorded(2, step) for step in range(4)])
    entries = exact.forward_sequence(steps, torch.zeros(4, 2, dtype=torch.bool))
    amps = torch.stack([torch.from_numpy(plain.see(row)["battery_current"]) for row in steps])
    score = ((amps - 5.0) / 2.0).float().unsqueeze(-1)
    torch.testing.assert_close(entries["measured", "battery_current"], score)
    torch.testing.assert_close(entries["real_reward", "power"], power.reward(score))


def test_motors_warm_up_and_cost_more_and_then_stay_as_warm(spec, make):
    seen, row = SimulatedInstruments(make, spec, 1), recorded(1)
    watts = []
    for _ in range(50 * 21):
        told = seen.see(row)
        watts.append(float((told["battery_current"] * told["battery_voltage"])[0]))
    assert np.mean(watts[100:149]) < np.mean(watts[151:200])  # steady heat from the fourth second on
    assert np.mean(watts[-100:-50]) == pytest.approx(np.mean(watts[-50:]), rel=1e-2)


def test_a_quantity_that_depends_on_how_feet_land_is_refused(registry):
    pytest.importorskip("hts_noise")
    robot = registry.make_robot("go1")
    make = OracleRobot(robot, WORLD, {"noise": {}}, registry).instruments
    with pytest.raises(UnfitWorldError, match=r"'sound_level' depends on how feet land, and the training simulation "):
        check_exact(make, robot.spec, {"noise": registry.make_objective("noise")})


def test_a_quantity_that_no_instrument_tells_is_refused(registry, spec, make):
    noise = registry.make_objective("noise")
    with pytest.raises(UnfitWorldError, match="no instrument of this reality tells 'sound_level' exactly"):
        check_exact(make, spec, {"noise": noise})


def test_power_can_be_seen(registry, spec, make):
    check_exact(make, spec, {"power": registry.make_objective("power")})


@pytest.mark.slow
def test_a_tiny_one_is_a_run_but_for_what_pays_and_says_so(tmp_path, capfd):
    run = tmp_path / "run"
    assert main(["oracle", *TINY, "--out", str(run)]) == 0
    assert IN_SIMULATION in capfd.readouterr().out
    summary = json.loads((run / "summary.json").read_text())
    assert (summary["note"], summary["reward_source"]) == (IN_SIMULATION, "oracle")
    (first,) = summary["iterations"]
    fitted = json.loads((run / "iterations/00/fit.json").read_text())["power"]
    assert [one["weights"]["power"] for one in first["candidates"]] == fitted["weights"]  # λ as of a run
    assert "trust_region" in first and first["measurement_models"]["power"]["dataset"] == fitted["dataset"]
    judged = json.loads((run / "iterations/00/simulate.json").read_text())
    assert judged["predicted"]["00-00"]["power"]["0.8"]["improvement"] < 1  # promised in the unit of the final
    page = (run / "report.html").read_text()
    assert "trained in simulation, paid by what the instruments of the twin" in page and "No method." in page


@pytest.mark.parametrize(
    ("command", "said"),
    [
        (["run", "--set", "oracle_trains_in=simulation"], "oracle_trains_in: belongs to `hts oracle`"),
        (["oracle", "--set", "oracle_trains_in=nowhere"], "oracle_trains_in"),
        (
            ["oracle", "--in-simulation", "--start", "some.safetensors"],
            "start: of an oracle that trains on the reality",
        ),
        (["oracle", "--in-simulation", "--world", "field"], "World 'field' cannot be looked into"),
    ],
)
def test_a_mistake_is_one_line_and_leaves_nothing(tmp_path, capsys, command, said):
    assert main([command[0], *OF_POWER, "--out", str(tmp_path / "run"), *command[1:]]) != 0
    err = capsys.readouterr().err.strip()
    assert "\n" not in err and said in err and not (tmp_path / "run").exists()
