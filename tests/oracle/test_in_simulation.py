"""An oracle of the reward alone: `hts run`, with a reality's own instruments in the place of the fitted model."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest
import torch

from hts import plugins
from hts.cli.main import main
from hts.config import RunConfig
from hts.config_loading import load_config
from hts.contracts import Instrument
from hts.errors import PluginError, UnfitWorldError
from hts.oracle.in_simulation import prepared
from hts.worlds.oracle import IN_SIMULATION
from hts.worlds.oracle.simulated import ExactMeasurement, Seeing, SimulatedInstruments, check_exact

pytest.importorskip("hts_power", reason="its gauge knows the exact current")
pytest.importorskip("hts_go1", reason="a robot with legs")
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


@pytest.fixture(scope="module")
def registry():
    return plugins.load()


@pytest.fixture(scope="module")
def robot(registry):
    return registry.make_robot("go1")


@pytest.fixture(scope="module")
def seeing(registry, robot):
    return Seeing.of(robot, WORLD, {"power": {}}, registry)


def channels(spec, candidates: int, worlds: int, seed: int = 0) -> dict[str, torch.Tensor]:
    """Made-up physics steps, the same for every candidate."""
    random = torch.Generator().manual_seed(seed)

    def made(size: int, scale: float) -> torch.Tensor:
        one = scale * torch.randn(1, worlds, spec.substeps, size, generator=random)
        return one.expand(candidates, -1, -1, -1)

    joints, feet = spec.num_joints, len(spec.foot_sites)
    return {
        "substep_torque": made(joints, 5.0),
        "substep_velocity": made(joints, 4.0),
        "substep_force": made(feet, 40.0).abs(),
    }


def rows(spec, worlds: int, seed: int = 0) -> torch.Tensor:
    return torch.cat([value[0].flatten(1) for value in channels(spec, 1, worlds, seed).values()], 1)


def plain(seeing: Seeing, **parameters: float) -> Seeing:
    """A gauge whose numbers can be checked on paper, with motors that make what they are told."""
    from hts_power.gauge import BatteryGauge
    from hts_power.gauge_parameters import GaugeParameters

    same = dataclasses.replace(seeing.motors, constant=np.ones(12), saturation=np.zeros(12))
    return dataclasses.replace(
        seeing,
        make=lambda: {"battery_gauge": BatteryGauge(GaugeParameters(**parameters), seeing.spec)},
        strength=1.0,
        motors=same,
    )


def test_work_is_torque_times_speed_of_every_physics_step_and_what_is_told_is_what_the_bus_gave(seeing):
    seen, spec = SimulatedInstruments(plain(seeing), 1), seeing.spec
    torque, speed = torch.zeros(1, spec.substeps, 12), torch.zeros(1, spec.substeps, 12)
    torque[0, 0, 0], speed[0, 0, 0] = 10.0, 8.0  # 80 W in the first of the physics steps alone
    told = seen.see(torch.cat((torque.flatten(1), speed.flatten(1), torch.zeros(1, spec.substeps * 4)), 1))
    (gauge,) = seen._made.values()
    assert gauge.energy["mechanical"][0] == pytest.approx(80.0 * spec.physics_dt)
    watts = float((told["battery_current"] * told["battery_voltage"])[0])
    assert watts == pytest.approx(gauge.energy["bus"][0] / (spec.substeps * spec.physics_dt))


def test_motors_that_make_less_of_their_current_cost_as_much_and_give_less(seeing):
    weak = dataclasses.replace(seeing.motors, constant=np.full(12, 0.5), saturation=np.zeros(12))
    strong = plain(seeing, idle_power=30.0)
    row = rows(seeing.spec, 4).abs()  # all motors drive
    found = {}
    for name, one in {"strong": strong, "weak": dataclasses.replace(strong, motors=weak)}.items():
        instruments = SimulatedInstruments(one, 4)
        instruments.see(row)
        (found[name],) = (gauge.energy for gauge in instruments._made.values())
    np.testing.assert_allclose(found["weak"]["mechanical"], 0.5 * found["strong"]["mechanical"], rtol=1e-9)
    np.testing.assert_allclose(found["weak"]["copper"], found["strong"]["copper"], rtol=1e-9)


def test_it_stands_for_the_model_in_the_models_own_scale(registry, seeing):
    power, spec = registry.make_objective("power"), seeing.spec
    exact = ExactMeasurement(power, Fitted(), seeing)
    alone = SimulatedInstruments(seeing, 2)
    steps = torch.stack([exact.record(channels(spec, 1, 2, step)) for step in range(4)])
    entries = exact.forward_sequence(steps, torch.zeros(4, 2, dtype=torch.bool))
    amps = torch.stack([torch.from_numpy(alone.see(row)["battery_current"]) for row in steps])
    score = ((amps - 5.0) / 2.0).float().unsqueeze(-1)
    torch.testing.assert_close(entries["measured", "battery_current"], score)
    torch.testing.assert_close(entries["real_reward", "power"], power.reward(score))


def test_who_walks_alike_is_paid_alike_and_as_alone(registry, seeing):
    power, spec = registry.make_objective("power"), seeing.spec
    crowd, alone = (ExactMeasurement(power, Fitted(), seeing) for _ in range(2))
    for step in range(3):
        together = crowd.evaluate(crowd.record(channels(spec, 3, 4, step)))["real_reward", "power"]
        one = alone.evaluate(alone.record(channels(spec, 1, 4, step)))["real_reward", "power"]
        assert torch.equal(together, one.repeat(3, 1))


def test_motors_warm_up_and_cost_more_from_the_eleventh_second_on(seeing):
    warm = SimulatedInstruments(seeing, 1)
    row = rows(seeing.spec, 1)
    watts = []
    for _ in range(50 * 12):
        told = warm.see(row)
        watts.append(float((told["battery_current"] * told["battery_voltage"])[0]))
    assert np.mean(watts[450:499]) + 1.0 < np.mean(watts[501:550])
    assert np.mean(watts[501:550]) == pytest.approx(np.mean(watts[550:600]), rel=1e-2)


def test_it_cannot_be_saved_in_mid_stage(registry, seeing):
    assert not ExactMeasurement(registry.make_objective("power"), Fitted(), seeing).savable


# ------------------------------------------------------------------------------------------------------- refusals


def test_power_can_be_seen(registry, seeing):
    check_exact(seeing, {"power": registry.make_objective("power")})


def test_a_quantity_that_depends_on_how_feet_land_is_refused(registry, robot):
    pytest.importorskip("hts_noise")
    of_noise = Seeing.of(robot, WORLD, {"noise": {}}, registry)
    with pytest.raises(UnfitWorldError, match=r"'sound_level' depends on how fast and with what mass feet land"):
        check_exact(of_noise, {"noise": registry.make_objective("noise")})


class Telling(Instrument):
    """An instrument whose `exact` is what the test wants."""

    channels = ()

    def __init__(self, told) -> None:
        self._told = told

    def reset(self, num_worlds, rng) -> None:
        self._worlds = num_worlds

    def step(self, sample) -> None:
        pass

    def read(self):
        return {}

    def idle(self):
        return {}

    def exact(self):
        return self._told(self._worlds)


@pytest.mark.parametrize(
    ("told", "kind", "said"),
    [
        (lambda worlds: {}, UnfitWorldError, "no instrument of this reality tells 'battery_current' exactly"),
        (
            lambda worlds: {"battery_current": np.ones((worlds, 2))},
            UnfitWorldError,
            "expected a finite number for each. Correct its `exact`",
        ),
        (
            lambda worlds: {"battery_current": np.full(worlds, np.nan)},
            UnfitWorldError,
            "expected a finite number for each",
        ),
        (lambda worlds: {}["current"], PluginError, "Instrument 'mine' failed, KeyError"),
    ],
)
def test_an_instrument_that_tells_nothing_usable_is_one_line(registry, seeing, told, kind, said):
    mine = dataclasses.replace(seeing, make=lambda: {"mine": Telling(told)})
    with pytest.raises(kind, match=said):
        check_exact(mine, {"power": registry.make_objective("power")})


@pytest.mark.parametrize(
    ("command", "said"),
    [
        (["run", "--set", "oracle_trains_in=simulation"], "oracle_trains_in: belongs to `hts oracle`"),
        (["oracle", "--in-simulation", "--set", "reward_source=proxy"], "Found reward_source proxy: leave one of"),
        (["oracle", "--set", "oracle_trains_in=nowhere"], "oracle_trains_in"),
        (["oracle", "--set", "reward_source=foo"], "--set reward_source: expected oracle, found 'foo'."),
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


def test_on_a_gpu_no_step_is_captured_since_instruments_compute_on_the_host(registry):
    def asked(engine: str) -> RunConfig:
        given = ["reward_source=oracle", "oracle_trains_in=simulation", f"engine={engine}"]
        return load_config(preset="smoke", objectives=["power"], robot="go1", overrides=given, registry=registry)

    assert not prepared(asked("warp"), registry).finetune.ppo.capture
    assert prepared(asked("mujoco"), registry) == asked("mujoco")


# ---------------------------------------------------------------------------------------------------------- a run


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
    (run / "summary.json").unlink()
    (run / "iterations/00/simulate.json").unlink()  # as if it had been stopped there
    assert main(["resume", str(run)]) == 0
    assert json.loads((run / "iterations/00/simulate.json").read_text()) == judged
