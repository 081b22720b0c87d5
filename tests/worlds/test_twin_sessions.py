"""The twin's sessions, and the process that they run in."""

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
from witness import Witness

from hts import plugins
from hts.contracts import WorldContext
from hts.errors import PluginError, PolicyError, WorldError
from hts.worlds.base import request_id, seed_sequence, walking
from hts.worlds.twin.parameters import TwinSettings
from hts.worlds.twin.programme import Block, Session, head_to_head
from hts.worlds.twin.session import Batch
from hts.worlds.twin.world import make_twin


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
    moments = [float(one) for one in fallen.notes["fell_at"].split(",")]
    assert len(moments) == int(fallen.notes["falls"]) and "fell_at" not in standing.notes
    lying = fallen.values("projected_gravity")[[round(one * 50) for one in moments], 2] > -0.5
    assert lying.any() and 0.0 < moments[0] < moments[-1] < 3.0
    assert fallen.num_samples == 150


def test_a_policy_of_another_robot_is_refused_by_name(robot, tmp_path):
    path = exported_constant(tmp_path / "p.onnx", robot)
    model = onnx.load(path)
    card = json.loads(model.metadata_props[0].value)
    model.metadata_props[0].value = json.dumps({**card, "robot": "crab", "joint_names": card["joint_names"][::-1]})
    onnx.save(model, path)
    with pytest.raises(PolicyError, match="made for robot 'crab'"):
        batch(robot, 1).run([Session(id="s", blocks=(Block(policy=str(path), schedule=walking(0.5, 0.1)),))], "twin")


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
    with pytest.raises(
        WorldError, match=r"ended by signal 9 \(which the system sends to what takes more memory"
    ) as error:
        twin.idle()
    assert "\n" not in str(error.value)
    assert "stderr" not in str(error.value)  # it said nothing, so that file is taken away


def test_what_nobody_foresaw_in_the_twins_process_is_one_line_and_its_traceback_a_note(twin):
    with pytest.raises(PluginError, match=r"^The twin failed, KeyError: 'sessions'") as error:
        twin._staff(1)[0].ask({"do": "run"})
    assert "process.py" in error.value.__notes__[0]


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
    for _ in range(600):
        if not _alive(child):
            return
        time.sleep(0.1)
    os.kill(child, signal.SIGKILL)
    pytest.fail("the twin's process was still there a minute after its parent was killed")


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
