"""The twin's machine: its body, its sensors, its operator and its settings."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from witness import Witness

from hts import plugins
from hts.config import Command, ScheduleConfig
from hts.contracts import WorldContext
from hts.errors import ConfigError, HtsError
from hts.policies.files import load_policy
from hts.worlds.base import Operator, commands, in_groups
from hts.worlds.twin.dynamics import Dynamics
from hts.worlds.twin.model import build, columns
from hts.worlds.twin.parameters import DynamicsParameters, SensorParameters, TwinSettings, parameters_hash, resolved
from hts.worlds.twin.sensors import in_words
from hts.worlds.twin.session import Standing
from hts.worlds.twin.structure import BodyStructure, SessionParameters

ROOT = Path(__file__).parents[2]
PLAIN = DynamicsParameters(
    encoder_offset=0.0,
    friction_spread=0.0,
    torque_constant_error=0.0,
    joint_friction=0.3,
    joint_friction_extra_stage=0.6,
    gear_loss=0.05,
    gear_loss_extra_stage=0.07,
    full_torque_speed=0.5,
)


@pytest.fixture(scope="module")
def machine(robot):
    return build(robot, PLAIN)


# ------------------------------------------------------------------------------------------------ body


def _massless(root):
    root.find("body", "trunk").inertial.mass = 0


def _renamed(root):
    root.find("joint", "FL_calf_joint").name = "FL_knee"


def _on_a_stand(root):
    root.find("body", "trunk").freejoint.remove()


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (_massless, "compiling what .* must be larger than mjMINVAL"),
        (_renamed, "its model has no joint 'FL_calf_joint'"),
        (_on_a_stand, "expected a free joint of body 'trunk'"),
    ],
)
def test_a_model_of_which_there_is_no_twin_is_one_line_that_names_the_robot(robot, spoil, words):
    class Spoilt(type(robot)):
        def mjcf(self):
            root = super().mjcf()
            spoil(root)
            return root

    with pytest.raises(HtsError, match=f"^Robot 'go1'.*{words}"):
        build(Spoilt(robot.settings), PLAIN)


def test_the_twin_weighs_what_its_parameters_say(robot):
    light, heavy = (build(robot, DynamicsParameters(trunk_mass_scale=scale)) for scale in (1.0, 1.2))
    trunk = light.model.body(robot.spec.trunk_body).mass[0]
    assert heavy.total_mass - light.total_mass == pytest.approx(0.2 * trunk)


def test_only_the_joints_with_a_further_gear_stage_get_its_friction(machine, robot):
    ratio = np.array(robot.spec.motors.gear_ratio)
    assert machine.friction.tolist() == np.where(ratio > ratio.min(), 0.6, 0.3).tolist()
    assert machine.gear_loss.tolist() == np.where(ratio > ratio.min(), 0.07, 0.05).tolist()


def test_a_standing_twin_carries_its_weight_in_its_default_pose(machine):
    body, stand = Dynamics(machine, PLAIN, 1), Standing(machine)
    stand.start(1)
    for _ in range(50):
        body.advance(stand.targets({}), 20, ())
    assert body.foot_force.sum() == pytest.approx(9.81 * machine.total_mass, rel=0.01)
    assert np.abs(body.joint_position() - machine.spec.default_pose).max() < 0.05
    assert body.time[0] == pytest.approx(1.0)


def test_a_target_acts_after_the_delay(machine):
    body, witness = Dynamics(machine, DynamicsParameters(actuation_delay=0.005), 1), Witness()
    witness.reset(1, np.random.default_rng(0))
    pose = np.array([machine.spec.default_pose])
    body.advance(pose + 0.1, 10, (witness,))
    jump = np.abs(np.diff(np.array(witness.torque)[:, 0, 0]))
    assert jump.argmax() == 4  # between the fifth and the sixth step: five steps still with the old target
    assert jump.max() == pytest.approx(0.1 * machine.spec.kp[0], rel=0.3)


def one_step(machine, parameters, target, speed) -> tuple[np.ndarray, np.ndarray]:
    """Motor torque and torque that arrives at the joints, in the first step from the default pose at a joint speed."""
    parameters = parameters.model_copy(update={"actuation_delay": 0.0})
    body, witness = Dynamics(machine, parameters, 1), Witness()
    witness.reset(1, np.random.default_rng(0))
    body.qvel[:, machine.joint_dof] = speed
    body.advance(np.array([machine.spec.default_pose]) + target, 1, (witness,))
    return witness.torque[0][0], body._control[0, 0].copy()


def test_motor_torque_is_proportional_control_plus_damping(machine):
    motor, _ = one_step(machine, PLAIN, 0.1, 1.0)
    assert motor == pytest.approx(0.1 * np.array(machine.spec.kp) - 1.0 * np.array(machine.spec.kd))


def test_a_moving_gear_loses_a_share_of_the_motor_torque(machine):
    motor, delivered = one_step(machine, PLAIN, 0.2, 2.0)
    assert motor - delivered == pytest.approx(machine.gear_loss * np.abs(motor))
    motor, delivered = one_step(machine, PLAIN, 0.2, -2.0)
    assert delivered - motor == pytest.approx(machine.gear_loss * np.abs(motor))


def test_gear_friction_is_nothing_at_rest(machine):
    motor, delivered = one_step(machine, PLAIN, 0.2, 0.0)
    assert delivered == pytest.approx(motor)


def test_motoring_torque_falls_to_nothing_at_no_load_speed_and_braking_stays(machine):
    limit, no_load = np.array(machine.spec.torque_limit), np.array(machine.spec.velocity_limit)
    assert one_step(machine, PLAIN, 50.0, 0.75 * no_load)[0] == pytest.approx(0.5 * limit)
    assert one_step(machine, PLAIN, 50.0, 1.2 * no_load)[0] == pytest.approx(0.0)
    assert one_step(machine, PLAIN, -50.0, 0.75 * no_load)[0] == pytest.approx(-limit)
    assert one_step(machine, PLAIN, 50.0, 0.3 * no_load)[0] == pytest.approx(limit)


def test_a_motor_makes_more_than_its_firmware_believes_by_its_torque_constant_error(machine):
    parameters = PLAIN.model_copy(update={"torque_constant_error": 0.05})
    plain, _ = one_step(machine, PLAIN, 0.1, 0.0)
    stronger, _ = one_step(machine, parameters, 0.1, 0.0)
    assert stronger == pytest.approx(1.05 * plain)


def test_what_is_fixed_per_machine_is_the_same_each_time_and_differs_between_machines(robot):
    offsets = [build(robot, DynamicsParameters(machine=number)).encoder_offset for number in (1, 1, 2)]
    assert (offsets[0] == offsets[1]).all()
    assert (offsets[0] != offsets[2]).all()


def test_a_foot_weighs_a_few_hundred_grams_to_the_floor(machine):
    # published estimate with rotor inertia: 0.50 to 0.63 kg
    assert ((machine.foot_mass > 0.45) & (machine.foot_mass < 0.68)).all()


def test_evenly_spaced_addresses_become_a_slice():
    assert columns(np.array([3, 5, 7])) == slice(3, 8, 2)
    assert columns(np.array([4])) == slice(4, 5)
    assert columns(np.array([3, 5, 6])).tolist() == [3, 5, 6]


# ----------------------------------------------------------------------------------- sensors, operator


def test_words_have_whole_steps_and_step_nothing_leaves_values_alone():
    assert in_words(np.array([0.26, -0.26]), 0.25).tolist() == [0.25, -0.25]
    assert in_words(np.array([0.26]), 0.0).tolist() == [0.26]


def test_the_operator_turns_against_the_heading_error_and_no_faster_than_one():
    operator = Operator(3)
    commanded = np.array([[0.5, 0.0, 0.0]] * 3)
    operator.command(commanded, np.zeros(3))  # heading 0 is to be kept
    sent = operator.command(commanded, np.array([0.4, -3.0, 2 * np.pi + 0.2]))
    assert sent[:, 2] == pytest.approx([-0.2, 1.0, -0.1])


def test_the_operator_leaves_turns_and_standing_alone():
    operator = Operator(2)
    commanded = np.array([[0.5, 0.0, 0.3], [0.0, 0.0, 0.0]])
    operator.command(commanded, np.zeros(2))
    assert operator.command(commanded, np.full(2, 0.4)).tolist() == commanded.tolist()


def test_a_schedule_becomes_one_command_per_control_step():
    schedule = ScheduleConfig(commands=(Command(seconds=0.1, vx=0.5), Command(seconds=0.05, vx=0.8, yaw_rate=0.2)))
    rows = commands(schedule, 50.0)
    assert rows[:, 0].tolist() == [0.5] * 5 + [0.8] * 3  # 7.5 steps in all are 8
    assert rows[-1].tolist() == [0.8, 0.0, 0.2]


def test_worlds_are_cut_into_nearly_equal_groups():
    assert [len(group) for group in in_groups(14, 6)] == [5, 4, 5]
    assert [len(group) for group in in_groups(3, 6)] == [2, 1]
    assert [len(group) for group in in_groups(1, 6)] == [1]
    assert in_groups(0, 6) == []


# --------------------------------------------------------------------------------------------- settings


def test_every_parameter_of_the_twin_states_unit_source_and_range():
    for model in (DynamicsParameters, SensorParameters, BodyStructure, SessionParameters):
        for name, field in model.model_fields.items():
            if name == "structure":
                continue
            assert {"unit", "source"} <= set(field.json_schema_extra), name
            if field.annotation is not bool:
                low, high = field.json_schema_extra["range"]
                assert low <= field.default <= high, name


def test_structures_and_differing_sessions_are_off_and_not_in_the_hash_unless_they_are_on():
    for model in (BodyStructure, SessionParameters):
        assert all(field.default in (0, False) for field in model.model_fields.values())
    resolved_default = resolved(TwinSettings(), {})
    assert "structure" not in resolved_default["dynamics"] and "sessions" not in resolved_default
    base = parameters_hash(TwinSettings(), {})
    assert parameters_hash(TwinSettings(dynamics={"structure": {"wind_force": 1.0}}), {}) != base
    assert parameters_hash(TwinSettings(sessions={"heading_offset": 0.1}), {}) != base


def test_a_misspelt_parameter_is_one_line_with_the_closest_name(tmp_path):
    context = WorldContext("go1", {}, {"power": {}}, 0, tmp_path)
    with pytest.raises(ConfigError, match="trunk_mass_scale") as error:
        plugins.load().make_world("twin", {"dynamics": {"trunk_mas_scale": 1.1}}, context)
    assert "\n" not in str(error.value)


def test_the_hash_covers_the_machine_and_not_how_sessions_go():
    base = parameters_hash(TwinSettings(), {"x": {"a": 1}})
    assert parameters_hash(TwinSettings(block_seconds=5, warmup_seconds=3, processes=2), {"x": {"a": 1}}) == base
    assert parameters_hash(TwinSettings(dynamics={"trunk_mass_scale": 1.05}), {"x": {"a": 1}}) != base
    assert parameters_hash(TwinSettings(), {"x": {"a": 2}}) != base


def test_the_twin_is_the_one_that_was_calibrated(robot):
    committed = ROOT / "docs" / "twin-calibration.json"
    if not committed.exists():
        pytest.skip(
            "docs/twin-calibration.json is not written yet: "
            "`hts calibrate-twin --gap --write docs/twin-calibration.json`"
        )
    gauge = plugins.load().make_instrument("battery_gauge", {}, robot)
    now = parameters_hash(TwinSettings(), {"battery_gauge": gauge.describe()})
    assert json.loads(committed.read_text())["parameters_sha256"] == now, (
        "A default of the twin or its gauge changed after calibration. "
        "Calibrate again by the rule of docs/twin.md, and start over."
    )
    shipped = load_policy(robot.pretrained_policy()).card.policy_hash
    assert json.loads(committed.read_text())["policy_hash"] == shipped, (
        "The shipped policy is not the one that the twin was calibrated with. "
        "Calibrate again by the rule of docs/twin.md, and start over."
    )
