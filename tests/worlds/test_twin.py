"""The twin: its body, its sensors, its sessions and its process."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper

from hts import plugins
from hts.config import Command, ScheduleConfig
from hts.contracts import Instrument, PhysicsSample, WorldContext
from hts.errors import ConfigError, PolicyError, WorldError
from hts.policies.files import load_policy
from hts.worlds.base import Operator, commands, in_groups, request_id, seed_sequence, walking
from hts.worlds.twin.dynamics import Dynamics
from hts.worlds.twin.model import build, columns
from hts.worlds.twin.parameters import DynamicsParameters, SensorParameters, TwinSettings, parameters_hash, resolved
from hts.worlds.twin.programme import Block, Session, head_to_head
from hts.worlds.twin.sensors import in_words
from hts.worlds.twin.session import Batch, Standing
from hts.worlds.twin.structure import BodyStructure, SessionParameters
from hts.worlds.twin.world import make_twin

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
def robot():
    return plugins.load().make_robot("go1")


@pytest.fixture(scope="module")
def machine(robot):
    return build(robot, PLAIN)


def exported_constant(path: Path, robot, action: float | np.ndarray = 0.0) -> Path:
    """An ONNX policy that always gives the same action."""
    spec, size = robot.spec, 9 + 3 * robot.spec.num_joints
    bias = np.broadcast_to(np.float32(action), spec.num_joints)
    weights = [
        numpy_helper.from_array(np.zeros((size, spec.num_joints), np.float32), "w"),
        numpy_helper.from_array(np.ascontiguousarray(bias), "b"),
    ]
    graph = helper.make_graph(
        [helper.make_node("Gemm", ["observation", "w", "b"], ["action"])],
        "policy",
        [helper.make_tensor_value_info("observation", TensorProto.FLOAT, ["batch", size])],
        [helper.make_tensor_value_info("action", TensorProto.FLOAT, ["batch", spec.num_joints])],
        weights,
    )
    parts = {
        "angular_velocity": 3,
        "projected_gravity": 3,
        "command": 3,
        "joint_position_offset": spec.num_joints,
        "joint_velocity": spec.num_joints,
        "last_action": spec.num_joints,
    }
    card = {
        "robot": spec.name,
        "joint_names": spec.joint_names,
        "default_pose": spec.default_pose,
        "kp": spec.kp,
        "action_scale": spec.action_scale,
        "kd": spec.kd,
        "control_rate_hz": spec.control_rate_hz,
        "history": 1,
        "observation": [{"name": name, "size": number} for name, number in parts.items()],
        "policy_hash": f"constant {np.sum(bias):g}",
    }
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    helper.set_model_props(model, {"hts": json.dumps(card)})
    onnx.save(model, path)
    return path


class Witness(Instrument):
    """Keeps every physics sample, and counts what it is told."""

    channels = ()

    def reset(self, num_worlds, rng):
        self.torque, self.settled = [], 0

    def step(self, sample: PhysicsSample):
        self.torque.append(sample.motor_torque.copy())

    def read(self):
        return {}

    def idle(self):
        return {}

    def settle(self):
        self.settled += 1


# ------------------------------------------------------------------------------------------------ body


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


# -------------------------------------------------------------------------------------------- sessions


def batch(robot, num_worlds: int, seed: int = 0, instruments=None, **settings) -> Batch:
    return Batch(
        robot,
        TwinSettings(**settings),
        instruments if instruments is not None else {},
        num_worlds,
        seed_sequence(seed, request_id("test")),
    )


def stand(seconds: float) -> Session:
    return Session(id="s", blocks=(Block(policy=None, schedule=walking(0.5, seconds)),))


def test_a_recording_holds_the_robots_channels_and_the_instruments(robot):
    gauge = plugins.load().make_instrument("battery_gauge", {}, robot)
    made = batch(robot, 2, instruments={"battery_gauge": gauge})
    recordings = made.run([stand(1.0)] * 2, "twin")
    first = recordings[0][0]
    assert set(first.channels) == set(robot.channels()) | {channel.name for channel in gauge.channels}
    assert set(first.idle) == {"battery_current", "battery_voltage"}
    assert first.num_samples == 50
    assert first.mass_kg == pytest.approx(made.machine.total_mass, abs=0.025)
    assert not first.fell
    assert np.abs(first.values("joint_torque") / 0.0247 % 1 - 0.5).min() > 0.49  # whole words only
    # another robot of the same batch has noise of its own
    assert (recordings[1][0].values("joint_position") != first.values("joint_position")).any()


def test_the_same_seed_gives_the_same_recording_and_another_does_not(robot):
    values = [batch(robot, 1, seed).run([stand(0.4)], "twin")[0][0].values("joint_torque") for seed in (3, 3, 4)]
    assert (values[0] == values[1]).all()
    assert (values[0] != values[2]).any()


def test_a_head_to_head_warms_up_settles_and_goes_reference_policy_policy_reference(robot, tmp_path):
    policy, reference = (
        exported_constant(tmp_path / "p.onnx", robot, 0.02),
        exported_constant(tmp_path / "r.onnx", robot),
    )
    witness = Witness()
    session = head_to_head([str(policy)], str(reference), [0.5], warmup=1.0, block=0.5, session="duel")
    recordings = batch(robot, 1, instruments={"witness": witness}).run([session], "twin")[0]
    assert [recording.role for recording in recordings] == ["reference", "policy", "policy", "reference"]
    assert [recording.block for recording in recordings] == [0, 1, 2, 3]
    assert {recording.session for recording in recordings} == {"duel"}
    assert [recording.policy_hash for recording in recordings] == [
        "constant 0",
        "constant 0.24",
        "constant 0.24",
        "constant 0",
    ]
    assert witness.settled == 2
    clock = np.concatenate([recording.time for recording in recordings])
    assert np.diff(clock) == pytest.approx(0.02)  # one robot, swaps without delay
    assert len(witness.torque) == (1.0 + 1.0 + 4 * 0.5) * 1000


def test_heat_stays_when_policies_are_swapped(robot):
    gauge = plugins.load().make_instrument("battery_gauge", {"start_temperature": 70.0}, robot)
    made = batch(robot, 1, instruments={"battery_gauge": gauge})
    made.run([stand(0.2)], "twin")
    warm = gauge.winding.copy()
    made.run([stand(0.02)], "twin")
    assert gauge.winding == pytest.approx(warm, abs=0.1)
    assert (warm > 60).all()


def test_a_robot_that_falls_is_marked_and_stood_up_again(robot, tmp_path):
    # Right legs folded, left legs stretched, hips turned: it goes down at once, whenever it is stood up.
    tip = np.tile([2.4, 1.0, -2.5, 2.4, -2.5, 2.6], robot.spec.num_joints // 6)
    policy = exported_constant(tmp_path / "tip.onnx", robot, tip)
    sessions = [
        Session(id=str(path), blocks=(Block(policy=path, schedule=walking(0.5, 3.0)),)) for path in (str(policy), None)
    ]
    fallen, standing = (row[0] for row in batch(robot, 2).run(sessions, "twin"))
    assert fallen.fell and not standing.fell
    assert int(fallen.notes["falls"]) >= 2  # so it stood again in between
    assert fallen.num_samples == 150


def test_a_policy_of_another_robot_is_refused_by_name(robot, tmp_path):
    path = exported_constant(tmp_path / "p.onnx", robot)
    model = onnx.load(path)
    card = json.loads(model.metadata_props[0].value)
    model.metadata_props[0].value = json.dumps({**card, "robot": "crab", "joint_names": card["joint_names"][::-1]})
    onnx.save(model, path)
    with pytest.raises(PolicyError, match="made for robot 'crab'"):
        batch(robot, 1).run([Session(id="s", blocks=(Block(policy=str(path), schedule=walking(0.5, 0.1)),))], "twin")


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


# ---------------------------------------------------------------------------------------------- process


@pytest.fixture
def twin(tmp_path):
    settings = {"processes": 1, "warmup_seconds": 1, "block_seconds": 1}
    world = make_twin(settings, WorldContext("go1", {}, {"power": {}}, 7, tmp_path))
    yield world
    world.close()


def test_the_twins_process_gives_recordings_and_the_same_ones_when_asked_again(twin, robot, tmp_path):
    policy = exported_constant(tmp_path / "p.onnx", robot)
    first = twin.head_to_heads([policy, policy], policy, [0.5])
    again = twin.head_to_heads([policy, policy], policy, [0.5])
    assert [[r.id for r in row] for row in first] == [[r.id for r in row] for row in again]
    assert len({r.id for row in first for r in row}) == 8  # two sessions, noise of their own
    assert first[0][0].session != first[1][0].session
    assert {r.world for row in first for r in row} == {"twin"}


def test_a_users_mistake_in_the_twins_process_arrives_as_what_it_is(twin, tmp_path):
    broken = tmp_path / "broken.onnx"
    broken.write_bytes(b"nothing")
    with pytest.raises(PolicyError, match="broken.onnx") as error:
        twin.collect([broken], walking(0.5, 0.1))
    assert "\n" not in str(error.value)


def test_a_twin_that_dies_is_one_line(twin):
    twin.idle()
    os.kill(twin._children[0].pid, signal.SIGKILL)
    with pytest.raises(WorldError, match="ended by signal 9") as error:
        twin.idle()
    assert "\n" not in str(error.value)


def test_a_killed_run_leaves_no_twin_behind(tmp_path):
    code = (
        "import time; from pathlib import Path; "
        "from hts.contracts import WorldContext; from hts.worlds.twin.world import make_twin\n"
        f"world = make_twin({{}}, WorldContext('go1', {{}}, {{'power': {{}}}}, 0, Path({str(tmp_path)!r})))\n"
        "world.idle(); print(world._children[0].pid, flush=True); time.sleep(60)"
    )
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(part for part in sys.path if part)}
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True, env=environment) as parent:
        child = int(parent.stdout.readline())
        parent.kill()
    for _ in range(100):
        if not _alive(child):
            return
        time.sleep(0.1)
    os.kill(child, signal.SIGKILL)
    pytest.fail("the twin's process was still there 10 s after its parent was killed")


def _alive(pid: int) -> bool:
    """Whether a process runs; one that ended but that nobody waited for does not."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except OSError:
        return False


def test_the_twins_process_has_no_learning_code(tmp_path):
    code = (
        "import hts.worlds.twin.process, hts.worlds.twin.session, hts.policies.deploy, sys; "
        "print('torch' in sys.modules)"
    )
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(part for part in sys.path if part)}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=environment, check=True)
    assert done.stdout.strip() == "False"
