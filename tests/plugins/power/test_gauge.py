"""The physics of the battery gauge, each formula against numbers on paper."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
from pydantic import ValidationError

from hts.contracts import JointMotors, PhysicsSample, RobotSpec
from hts.errors import WorldError
from hts_power import drive_train as dt
from hts_power.battery import Battery, open_circuit_voltage, steady_current
from hts_power.gauge import BatteryGauge, make_gauge
from hts_power.gauge_parameters import GaugeParameters
from hts_power.structure import GaugeStructure

STEP = 0.001
QUIET = {"noise": 0.0, "resolution": 0.0, "gain_error": 0.0, "offset": 0.0}


MOTORS = JointMotors(torque_constant=(0.5, 1.0), gear_ratio=(6.0, 12.0), phase_resistance_ohm=(0.13, 0.13))


def spec(motors: JointMotors | None = MOTORS) -> RobotSpec:
    two = (1.0, 1.0)
    return RobotSpec(
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


def gauge(num_worlds: int = 1, seed: int = 0, **settings) -> BatteryGauge:
    made = BatteryGauge(GaugeParameters(**settings), spec())
    made.reset(num_worlds, np.random.default_rng(seed))
    return made


def drive(made: BatteryGauge, torque, speed, seconds: float) -> None:
    """Constant torque and speed of both joints, (J,) or (W, J), for so long; looked at every 20 ms."""
    num = len(made.winding)
    none = np.zeros((num, 0))
    torque, speed = (np.array(np.broadcast_to(x, (num, 2)), dtype=float) for x in (torque, speed))
    for step in range(round(seconds / STEP)):
        made.step(PhysicsSample(torque, speed, none, none, none, STEP))
        if step % 20 == 19:
            made.read()
    made.read()


# ---------------------------------------------------------------------------------------------- drives


def test_copper_coefficient_is_one_and_a_half_r_over_k_squared():
    assert dt.copper_coefficient(0.13, 0.5) == pytest.approx(1.5 * 0.13 / 0.25) == pytest.approx(0.78)


def test_copper_loss_at_25_degrees_is_c_tau_squared():
    assert dt.copper_power(10.0, 0.5, 25.0) == pytest.approx(50.0)


def test_copper_loss_grows_by_a_fifth_in_50_kelvin():
    assert dt.copper_power(10.0, 0.5, 75.0) == pytest.approx(50.0 * (1 + 0.00393 * 50)) == pytest.approx(59.825)


def test_iron_loss_is_the_same_in_both_directions():
    # 0.01 * 100 + 1e-4 * 100^2 = 1 + 1
    assert dt.iron_power(np.array([100.0, -100.0]), 0.01, 1e-4).tolist() == [2.0, 2.0]


def test_inverter_loss_is_conduction_plus_switching_plus_dead_time():
    conduction = dt.inverter_power(10.0, 0.0, 0.004, 0.0, 0.0, 30e3, 0.8)
    assert conduction == pytest.approx(1.5 * 0.004 * 100)
    switching = dt.inverter_power(10.0, 20.0, 0.0, 1e-7, 0.0, 30e3, 0.8)
    assert switching == pytest.approx(3 / np.pi * 20 * 10 * 1e-7 * 30e3) == pytest.approx(0.573, abs=1e-3)
    dead = dt.inverter_power(10.0, 20.0, 0.0, 0.0, 1e-7, 30e3, 0.8)
    assert dead == pytest.approx(12 / np.pi * 10 * 0.8 * 1e-7 * 30e3) == pytest.approx(0.0917, abs=1e-4)


def test_one_joints_braking_feeds_another_without_loss():
    assert dt.bus_power(30.0, np.array([50.0, -40.0]), regeneration=0.0) == 40.0


def test_only_what_is_left_over_reaches_the_battery_at_the_regeneration_efficiency():
    joints = np.array([20.0, -100.0])  # with 30 W idle, -50 W are left over
    assert dt.bus_power(30.0, joints, regeneration=0.9) == pytest.approx(-45.0)
    assert dt.bus_power(30.0, joints, regeneration=0.0) == 0.0


def test_steady_temperatures_without_torque_come_from_iron_loss_alone():
    # half of 4 W flows through 1 + 2 K/W: 6 K, of which the housing keeps 2 W * 2 K/W
    winding, housing = dt.steady_temperatures(0.0, 4.0, 0.5, 25.0, 1.0, 2.0)
    assert (winding, housing) == (pytest.approx(31.0), pytest.approx(29.0))


def test_steady_winding_temperature_includes_the_resistance_it_causes():
    # c tau^2 = 10 W at 25 degC, 3 K/W: T = 25 + 30 (1 + 0.00393 (T - 25)) -> T - 25 = 30 / (1 - 0.1179)
    winding, _ = dt.steady_temperatures(20.0, 0.0, 0.5, 25.0, 1.0, 2.0)
    assert winding - 25 == pytest.approx(30 / (1 - 30 * 0.00393))


# --------------------------------------------------------------------------------------------- battery


def test_open_circuit_voltage_of_a_cell_at_63_percent_is_3_854_volts():
    assert open_circuit_voltage(0.63, 1) == pytest.approx(3.854, abs=5e-4)


def test_steady_current_delivers_the_power_after_the_sag():
    current = steady_current(22.0, 0.1, np.array([200.0, -40.0, 0.0]))
    assert current * (22.0 - 0.1 * current) == pytest.approx([200.0, -40.0, 0.0])


def test_a_source_gives_no_more_than_a_quarter_v_squared_over_r():
    assert steady_current(20.0, 0.1, 5000.0) == pytest.approx(100.0)  # V / (2 R)


def battery(**changes) -> Battery:
    values = {
        "num": 1,
        "state_of_charge": 0.8,
        "cells": 6,
        "capacity_coulomb": 3600.0,
        "resistance": 0.1,
        "polarisation_resistance": 0.04,
        "polarisation_seconds": 30.0,
        "bus_capacitance": 5e-3,
        "idle_power": 30.0,
    }
    return Battery(**{**values, **changes})


def test_charge_falls_by_current_times_time():
    pack = battery()
    before = pack.state_of_charge.copy()
    coulomb = sum(pack.deliver(np.full((20, 1), 100.0), STEP).sum() * STEP for _ in range(50))
    assert before - pack.state_of_charge == pytest.approx(coulomb / 3600.0)
    assert coulomb == pytest.approx(100.0 / 23.2, rel=0.02)  # 100 W for 1 s at about 23 V


def test_the_capacitor_holds_the_voltage_against_a_sudden_load():
    pack = battery(polarisation_resistance=0.0)
    before = float(pack.voltage[0])
    source = float(open_circuit_voltage(pack.state_of_charge, 6)[0])
    settled = source - 0.1 * steady_current(source, 0.1, 300.0)
    pack.deliver(np.full((1, 1), 300.0), 0.5e-3)  # one time constant R_p C_b = 0.5 ms
    assert before - pack.voltage[0] == pytest.approx((before - settled) * (1 - np.exp(-1)))


def test_polarisation_reaches_r1_times_current_with_its_time_constant():
    pack = battery(idle_power=0.0, capacity_coulomb=1e9)
    for _ in range(1500):  # 30 s
        pack.deliver(np.full((20, 1), 100.0), STEP)
    assert pack.polarisation[0] == pytest.approx(0.04 * pack.current[0] * (1 - np.exp(-1)), rel=2e-3)


# ----------------------------------------------------------------------------------------------- gauge


def test_the_energy_of_the_bus_is_the_sum_of_its_parts():
    made = gauge(start_temperature=50.0)
    drive(made, [3.0, 8.0], [4.0, -2.0], 1.0)
    joules = {name: float(value[0]) for name, value in made.energy.items()}
    assert joules["mechanical"] == pytest.approx(3 * 4 - 8 * 2)
    parts = ("idle", "mechanical", "copper", "iron", "inverter")
    assert joules["bus"] == pytest.approx(sum(joules[name] for name in parts))
    assert joules["battery"] == pytest.approx(joules["bus"], rel=2e-3)  # the capacitor's share apart


def test_copper_loss_of_the_gauge_uses_each_joints_own_constant():
    made = gauge(start_temperature=25.0, phase_resistance=0.1)
    drive(made, [2.0, 2.0], [0.0, 0.0], 0.1)
    # c = 1.5 * 0.1 / K^2: 0.6 at K = 0.5, 0.15 at K = 1; tau^2 = 4
    assert made.energy["copper"][0] / 0.1 == pytest.approx(4 * 0.75, rel=1e-3)


def test_a_motor_reaches_the_temperature_that_settle_computes():
    fast = {
        "phase_resistance": 0.13,
        "hysteresis": 0.008,
        "eddy": 4e-5,
        "winding_capacity": 30.0,
        "housing_capacity": 200.0,
        "start_temperature": 25.0,
    }
    settled = gauge(**fast)
    drive(settled, [3.0, 6.0], [1.0, 1.0], 0.1)
    settled.settle()
    # the same by waiting: the thermal model stepped for 2 h under that heat
    waited = gauge(**fast)
    coefficient = dt.copper_coefficient(0.13, np.array([0.5, 1.0]))
    iron = dt.iron_power(np.array([6.0, 12.0]), 0.008, 4e-5)
    for _ in range(7200):
        waited._warm(dt.copper_power(np.array([3.0, 6.0]), coefficient, waited.winding), iron, 1.0)
    assert settled.winding == pytest.approx(waited.winding, abs=1e-3)
    assert settled.housing == pytest.approx(waited.housing, abs=1e-3)


def test_heat_stays_in_the_windings_when_the_load_is_gone():
    made = gauge(start_temperature=25.0)
    drive(made, [5.0, 5.0], 0.0, 10.0)
    hot = made.winding.copy()
    drive(made, 0.0, 0.0, 10.0)
    # 25 s at most of 50: cools towards the housing with C_w R_wh = 48 s
    expected = made.p.ambient + (hot - made.p.ambient) * np.exp(-10 / 48)
    assert hot[0, 0] > 26
    assert made.winding == pytest.approx(expected, rel=0.02)


def test_a_load_without_steady_temperature_is_refused_by_the_joints_name():
    made = gauge()
    drive(made, [0.0, 60.0], 0.0, 0.1)
    with pytest.raises(WorldError, match="motor of b would overheat"):
        made.settle()


def test_the_gauge_shows_a_step_after_delay_and_window():
    made = gauge(**QUIET, window=0.1, delay=0.04, polarisation_resistance=0.0, housing_resistance=2.0)
    idle = made.read()["battery_current"][0]
    shown = []
    for _ in range(10):
        drive(made, [2.0, 2.0], [20.0, 20.0], 0.02)
        shown.append(made.read()["battery_current"][0] - idle)
    # nothing for 40 ms, then a straight line over the next 100 ms
    assert shown[:2] == pytest.approx([0.0, 0.0])
    assert shown[6] == pytest.approx(shown[9], rel=0.01)
    assert np.array(shown[2:7]) / shown[6] == pytest.approx([0.2, 0.4, 0.6, 0.8, 1.0], abs=0.01)


def test_the_gauge_holds_its_reading_between_updates():
    made = gauge(**QUIET, update_rate=5.0, window=0.003, delay=0.01)
    readings = []
    for step in range(20):
        drive(made, [2.0, 2.0], [0.0, float(step)], 0.02)
        readings.append(float(made.read()["battery_current"][0]))
    assert len(set(readings[:9])) == 1  # updates come after 0.2 and 0.4 s
    assert readings[9] != readings[8]
    assert len(set(readings[9:19])) == 1


def test_gain_offset_and_resolution_of_a_reading():
    plain = gauge(**QUIET).read()["battery_current"][0]
    off = gauge(**{**QUIET, "gain_error": 0.01, "offset": 0.02}).read()["battery_current"][0]
    assert off == pytest.approx(1.01 * plain - 0.02)
    words = gauge(**{**QUIET, "resolution": 0.05}).read()["battery_current"][0] / 0.05
    assert words == pytest.approx(round(words))


def test_idle_is_idle_power_over_voltage():
    idle = gauge(**QUIET, idle_power=30.0).idle()
    assert idle["battery_current"] * idle["battery_voltage"] == pytest.approx(30.0)


def test_worlds_do_not_touch_each_other():
    together, alone = gauge(2, **QUIET), gauge(1, **QUIET)
    drive(together, np.array([[2.0, 3.0], [9.0, 9.0]]), [1.0, 1.0], 0.3)
    drive(alone, np.array([[2.0, 3.0]]), [1.0, 1.0], 0.3)
    assert together.read()["battery_current"][0] == pytest.approx(alone.read()["battery_current"][0])
    assert together.winding[0] == pytest.approx(alone.winding[0])


def test_the_same_seed_gives_the_same_noise_and_another_does_not():
    readings = []
    for seed in (1, 1, 2):
        made = gauge(seed=seed, resolution=0.0)
        drive(made, [2.0, 2.0], 1.0, 0.1)
        readings.append(made.read()["battery_current"][0])
    assert readings[0] == readings[1] != readings[2]


def test_a_reading_does_not_depend_on_how_often_somebody_looks():
    often, once = gauge(**QUIET), gauge(**QUIET)
    drive(often, [3.0, 3.0], [2.0, 2.0], 0.06)
    none = np.zeros((1, 0))
    for _ in range(60):
        once.step(PhysicsSample(np.full((1, 2), 3.0), np.full((1, 2), 2.0), none, none, none, STEP))
    assert once.read()["battery_current"] == pytest.approx(often.read()["battery_current"], rel=1e-3)


def test_a_robot_without_motor_constants_has_no_battery_gauge():
    robot = type("Robot", (), {"spec": spec(motors=None)})()
    with pytest.raises(WorldError, match="RobotSpec.motors"):
        make_gauge({}, robot)


def test_every_parameter_states_unit_source_and_range():
    fields = {**GaugeParameters.model_fields, **GaugeStructure.model_fields}
    for name, field in fields.items():
        if name == "structure":
            continue
        assert "ource: " in field.description, name
        if name != "cells" and field.annotation is not bool:
            assert {"unit", "source", "range"} <= set(field.json_schema_extra), name


def test_a_value_outside_its_range_is_refused():
    with pytest.raises(ValidationError, match="idle_power"):
        GaugeParameters(idle_power=80.0)


# --------------------------------------------------------------------------------- what it would show without errors


def test_exact_readings_carry_the_bus_power_whatever_the_gauge_shows():
    plain, bad = gauge(), gauge(gain_error=0.01, offset=0.02, noise=0.02, resolution=0.05, window=0.4, delay=0.1)
    for made in (plain, bad):
        drive(made, [3.0, 1.0], [4.0, -2.0], 1.0)
        made.exact()
        before, start = made.energy["bus"].copy(), made.seconds
        drive(made, [5.0, 1.0], [4.0, -2.0], 0.5)
        found = made.exact()
        power = found["battery_current"] * found["battery_voltage"]
        assert power == pytest.approx((made.energy["bus"] - before) / (made.seconds - start))
    levels = bad.exact_idle()
    assert levels["battery_current"] * levels["battery_voltage"] == pytest.approx(bad.p.idle_power)
    assert bad.exact_idle() == plain.exact_idle() and bad.idle() != plain.idle()
    perfect = gauge(gain_error=0.0, offset=0.0, state_of_charge=0.9)
    assert perfect.exact_idle() == perfect.idle()
    assert perfect.exact_idle()["battery_voltage"] > plain.exact_idle()["battery_voltage"]  # at 0.8, the default


def test_before_anything_has_passed_the_exact_reading_is_that_of_idling():
    found = gauge().exact()
    assert found["battery_current"] * found["battery_voltage"] == pytest.approx(gauge().p.idle_power)


def test_the_truth_is_the_mean_net_power_since_it_was_last_asked():
    made = gauge()

    def lost() -> float:
        return float(sum(made.energy[name][0] for name in ("copper", "iron", "inverter")))

    drive(made, [3.0, 1.0], [4.0, -2.0], 1.0)  # 10 W for 1 s
    first = lost()
    assert made.truth()["battery_current"] == pytest.approx(10.0 + first)
    drive(made, [3.0, 1.0], [8.0, -4.0], 0.5)  # 20 W for 0.5 s
    assert made.truth()["battery_current"] == pytest.approx(20.0 + (lost() - first) / 0.5)


def test_the_supply_is_the_packs_voltage_over_the_rated_one():
    made = gauge(cells=6, cell_noise=0.0)
    assert made.supply() == pytest.approx(made.read()["battery_voltage"] / 22.2, abs=1e-3)  # 6 cells of 3.7 V
    assert gauge(state_of_charge=1.0).supply() == pytest.approx(4.103 / 3.7, abs=0.02)  # what a full cell has


def test_a_gauge_that_filters_nothing_imports_no_scipy():
    code = "import sys, hts_power.gauge; sys.exit(any(name.partition('.')[0] == 'scipy' for name in sys.modules))"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
