"""Structures of the battery gauge's machine, each by what physics says that it changes."""

from __future__ import annotations

import numpy as np
import pytest

from hts.contracts import JointMotors, PhysicsSample, RobotSpec
from hts_power.gauge import BatteryGauge
from hts_power.gauge_parameters import GaugeParameters
from hts_power.structure import GaugeStructure

QUIET = {"noise": 0.0, "resolution": 0.0, "gain_error": 0.0, "offset": 0.0, "delay": 0.01, "cell_noise": 0.0}


def gauge(num_worlds: int = 1, seed: int = 0, structure: dict | None = None, **settings) -> BatteryGauge:
    motors = JointMotors(torque_constant=(0.5, 0.5), gear_ratio=(6.0, 6.0), phase_resistance_ohm=(0.13, 0.13))
    two = (1.0, 1.0)
    spec = RobotSpec(
        name="two_joints",
        joint_names=("a", "b"),
        default_pose=two,
        kp=two,
        kd=two,
        action_scale=two,
        torque_limit=two,
        velocity_limit=two,
        position_limit=((-1, 1), (-1, 1)),
        control_rate_hz=50.0,
        physics_dt=0.005,
        substeps=4,
        base_height=1.0,
        motors=motors,
    )
    made = BatteryGauge(GaugeParameters(**{**QUIET, **settings}, structure=structure or {}), spec)
    made.reset(num_worlds, np.random.default_rng(seed))
    return made


def drive(made: BatteryGauge, torque, speed, seconds: float, current=None) -> list[float]:
    """Constant torque and speed of both joints; the current shown every 20 ms by the first robot."""
    num, shown = len(made.winding), []
    none = np.zeros((num, 0))
    torque, speed = (np.array(np.broadcast_to(x, (num, 2)), dtype=float) for x in (torque, speed))
    current = None if current is None else np.array(np.broadcast_to(current, (num, 2)), dtype=float)
    for step in range(round(seconds * 1000)):
        made.step(PhysicsSample(torque, speed, none, none, none, 0.001, current))
        if step % 20 == 19:
            shown.append(float(made.read()["battery_current"][0]))
    return shown


def test_a_gauge_without_structures_says_nothing_of_them_in_its_description():
    assert "structure" not in gauge().describe()
    assert gauge(structure={"low_pass": True}).describe()["structure"]["low_pass"] is True
    assert all(field.default in (0, False) for name, field in GaugeStructure.model_fields.items() if name != "machine")


def test_a_low_pass_has_shown_63_percent_of_a_step_after_its_time_constant():
    made = gauge(window=0.2, structure={"low_pass": True}, bus_capacitance=0.002)
    before, shown = made.read()["battery_current"][0], drive(made, 10.0, 10.0, 2.0)
    rise = (np.array(shown) - before) / (shown[-1] - before)
    at = 0.02 * (1 + np.arange(len(rise))) - 0.01  # as it was `delay` ago
    assert np.interp(0.2, at, rise) == pytest.approx(1 - np.exp(-1), abs=0.01)
    assert np.interp(0.4, at, rise) == pytest.approx(1 - np.exp(-2), abs=0.01)
    mean = gauge(window=0.2, bus_capacitance=0.002)
    rise = np.array(drive(mean, 10.0, 10.0, 2.0))
    assert np.interp(0.1, at, (rise - before) / (rise[-1] - before)) == pytest.approx(0.5, abs=0.02)  # a mean: a ramp


def test_a_drive_that_burns_what_it_regenerates_asks_more_of_the_battery():
    driving, braking = [10.0, 10.0], [10.0, -10.0]  # +100 W and -100 W of mechanical power, and heat
    shared, alone = gauge(), gauge(structure={"own_regeneration": True})
    for made in (shared, alone):
        drive(made, driving, braking, 1.0)
    assert alone.energy["bus"][0] > shared.energy["bus"][0] + 20
    assert alone.energy["bus"][0] - alone.energy["burned"][0] == pytest.approx(shared.energy["bus"][0], rel=1e-3)
    same = [gauge(), gauge(structure={"own_regeneration": True})]
    for made in same:
        drive(made, 10.0, 10.0, 1.0)  # nobody regenerates
    assert same[0].energy["bus"][0] == pytest.approx(same[1].energy["bus"][0])


def test_a_converter_loses_a_share_and_a_square_of_what_passes_it():
    plain, lossy = gauge(), gauge(structure={"converter_share": 0.05, "converter_square": 2e-4})
    for made in (plain, lossy):
        drive(made, [10.0, 0.0], [10.0, 0.0], 1.0)
    power = plain.energy["bus"][0] - plain.energy["idle"][0]  # W, over one second
    assert lossy.energy["bus"][0] - plain.energy["bus"][0] == pytest.approx(0.05 * power + 2e-4 * power**2, rel=0.01)


def test_energy_of_the_bus_is_the_sum_of_its_parts_with_all_structures_on():
    made = gauge(
        2,
        structure={
            "converter_share": 0.05,
            "converter_square": 2e-4,
            "own_regeneration": True,
            "idle_spread": 0.1,
            "idle_seconds": 5.0,
        },
    )
    drive(made, [10.0, 10.0], [10.0, -10.0], 0.5)
    parts = ("idle", "mechanical", "copper", "iron", "inverter", "converter", "burned")
    assert sum(made.energy[name] for name in parts) == pytest.approx(made.energy["bus"])


def test_motors_of_one_type_differ_in_resistance_by_their_serial_number():
    heat = []
    for machine in (3, 3, 4):
        made = gauge(structure={"resistance_spread": 0.1, "machine": machine})
        drive(made, 10.0, 0.0, 0.1)
        heat.append(made._coefficient.copy())
    assert (heat[0] == heat[1]).all() and (heat[0] != heat[2]).all()
    assert np.abs(heat[0] / gauge()._coefficient - 1).max() <= 0.1


def test_heat_follows_the_current_and_mechanical_power_the_torque():
    alike, saturated = gauge(), gauge()
    drive(alike, 10.0, 1.0, 0.5)
    drive(saturated, 10.0, 1.0, 0.5, current=12.0)
    assert saturated.energy["copper"][0] == pytest.approx(1.44 * alike.energy["copper"][0], rel=0.01)
    assert saturated.energy["mechanical"][0] == pytest.approx(alike.energy["mechanical"][0])


def test_idle_power_wanders_around_its_mean_with_its_spread_and_time_constant():
    made = gauge(500, structure={"idle_spread": 0.1, "idle_seconds": 2.0}, idle_power=30.0)
    drawn = np.array([made._idle_power(0.02) for _ in range(200)])
    assert drawn.mean() == pytest.approx(30.0, rel=0.01)
    assert drawn.std() == pytest.approx(3.0, rel=0.05)
    left = ((drawn[0] - 30) * (drawn[100] - 30)).mean() / 9.0  # 2 s later
    assert left == pytest.approx(np.exp(-1), abs=0.12)


def test_sessions_begin_at_charges_of_their_own_which_are_noted_and_shown():
    made = gauge(300, state_of_charge=0.9, ambient=20.0, structure={"least_charge": 0.4, "ambient_spread": 4.0})
    noted, shown = made.conditions(), made.read()
    assert noted["state_of_charge"].min() >= 40 and noted["state_of_charge"].max() <= 90
    assert np.ptp(noted["state_of_charge"]) > 40
    assert (noted["state_of_charge"] == shown["state_of_charge"]).all()
    assert np.abs(noted["ambient"] - 20).max() <= 4 and np.ptp(noted["ambient"]) >= 6
    assert gauge(3).conditions() == {}
    full, empty = np.argmax(noted["state_of_charge"]), np.argmin(noted["state_of_charge"])
    assert made.supply()[full] > made.supply()[empty]


def test_the_supply_falls_under_load():
    made = gauge()
    rested = made.supply()[0]
    drive(made, 20.0, 10.0, 1.0)
    assert made.supply()[0] < rested - 0.03


def test_only_the_robot_that_facts_are_published_of_has_any():
    assert gauge().facts() == ()
