"""What the runtime takes, and what it refuses before anything moves."""

from __future__ import annotations

import hashlib
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import onnx
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from hts_go1_runtime import bundle as bundles
from hts_go1_runtime import machine
from hts_go1_runtime.bundle import CHECKSUMS, load_bundle
from hts_go1_runtime.cli import main
from hts_go1_runtime.errors import RuntimeFault

READ = bundles._read


def test_a_bundle_is_taken_as_the_world_wrote_it(bundle):
    found = load_bundle(bundle)
    assert [(row.log, row.role, row.trim, row.seconds) for row in found.rows] == [
        ("00", "reference", True, 1.0),
        ("01", "policy", True, 1.0),
    ]
    assert (found.hold.commands, found.hold.seconds, found.rate_hz) == ((0.2, 1.5), 2.0, 50.0)


@pytest.mark.parametrize("file", ["manifest.json", "policies/00-walk.onnx", "README.md"])
def test_a_changed_byte_is_found_and_named(bundle, file):
    content = bytearray((bundle / file).read_bytes())
    content[len(content) // 2] ^= 1
    (bundle / file).write_bytes(content)
    with pytest.raises(RuntimeFault, match=f"{file}: its SHA-256 is .*copy the bundle again"):
        load_bundle(bundle)


def policy(manifest):
    return manifest["policies"][0]


MISTAKES = {
    "a gain beyond the robot's": (lambda m: policy(m)["kp"].__setitem__(3, 200.0), "kp 200 of FL_hip_joint"),
    "a gain that is no number": (lambda m: policy(m)["kd"].__setitem__(0, float("nan")), "kd .* expected 12 numbers"),
    "another joint order": (lambda m: policy(m)["joint_names"].reverse(), "made for joints"),
    "a robot of other joints": (lambda m: m["robot"]["joint_names"].reverse(), "this robot's are"),
    "wider limits than the robot's": (
        lambda m: m["robot"]["position_limit"].__setitem__(2, [-3.5, -0.8]),
        "position_limit of FR_calf_joint is wider",
    ),
    "more torque than the robot's": (
        lambda m: m["robot"]["torque_limit"].__setitem__(0, 99.0),
        "torque_limit of FR_hip",
    ),
    "a pose outside the range": (lambda m: policy(m)["default_pose"].__setitem__(2, 0.5), "default_pose 0.5 rad"),
    "another control rate": (lambda m: policy(m).__setitem__("control_rate_hz", 100.0), "trained at 100.0 Hz"),
    "gains that the graph's card does not have": (
        lambda m: policy(m)["kp"].__setitem__(3, 31.0),
        "its own card says kp",
    ),
    "an observation in another order": (
        lambda m: policy(m)["observation"].insert(0, policy(m)["observation"].pop(1)),
        "its own card says that it observes angular_velocity, projected_gravity, .* the manifest projected_gravity, an",
    ),
    "actions that are clipped": (
        lambda m: m["control"].__setitem__("action_clip", 1.0),
        "action_clip 1.0; this runtime .* clips no action",
    ),
    "targets made otherwise": (
        lambda m: m["control"].__setitem__("target", "default_pose + action"),
        "target 'default_pose . action', .* this runtime makes targets as default_pose",
    ),
    "trained for what is no range": (
        lambda m: policy(m).__setitem__("trained", {"commands": {"vx": [1.5, 0.2]}}),
        "trained .* expected null, or `commands` with a smallest and a largest each",
    ),
    "trained for a number beyond all": (
        lambda m: policy(m).__setitem__("trained", {"commands": {"vx": [0, 10**400]}}),
        "not a whole manifest .OverflowError",
    ),
    "what no robot measures": (
        lambda m: policy(m)["observation"].append({"name": "base_velocity", "size": 3}),
        "observes 'base_velocity'",
    ),
    "a graph of other sizes": (lambda m: policy(m)["observation"].pop(), "the graph reads"),
    "noise that is not in the graph": (
        lambda m: policy(m).__setitem__("exploration", {"where": "graph"}),
        "the graph gives",
    ),
    "a row of no policy": (lambda m: m["rows"][0].__setitem__("policy", "policies/99.onnx"), "is no policy of"),
    "a row of another policy's hash": (
        lambda m: m["rows"][0].__setitem__("policy_hash", "f" * 64),
        "another policy_hash",
    ),
    "a log that leaves the folder": (lambda m: m["rows"][0].__setitem__("log", "../x"), "a row's log is called"),
    "a command of 30 m/s": (
        lambda m: m["rows"][0]["schedule"]["commands"][0].__setitem__("vx", 30.0),
        "row 00 commands 30",
    ),
    "ten hours of warming up": (lambda m: m.__setitem__("warmup_seconds", 36000.0), "warmup_seconds 36000, expected 0"),
    "a first run with all the torque there is": (
        lambda m: m["first_runs"].__setitem__("torque_scale", 3.0),
        "torque_scale 3, expected",
    ),
    "a later schema": (lambda m: m.__setitem__("schema_version", 2), "this runtime reads"),
    "a key that is not there": (lambda m: m.pop("control"), "not a whole manifest"),
    "trimming that nothing describes": (lambda m: m.__setitem__("hold", None), "nothing says how"),
    "a policy outside the bundle": (lambda m: policy(m).__setitem__("file", "../../walk.onnx"), "not in the bundle"),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_manifest_with_a_mistake_is_refused_in_one_line(change, mistake, capsys):
    edit, words = MISTAKES[mistake]
    folder = change(edit)
    with pytest.raises(RuntimeFault, match=words) as fault:
        load_bundle(folder)
    assert "\n" not in str(fault.value)
    assert main(["check", str(folder)]) == 2
    assert capsys.readouterr().err.startswith("refused: ")


JSON = st.recursive(
    st.none() | st.booleans() | st.floats() | st.integers(-(2**70), 2**70) | st.text(max_size=8),
    lambda inside: st.lists(inside, max_size=3) | st.dictionaries(st.text(max_size=8), inside, max_size=3),
    max_leaves=6,
)


def places(content, path=()):
    """Every place of a JSON value, as a path of keys."""
    keys = content.keys() if isinstance(content, dict) else range(len(content)) if isinstance(content, list) else ()
    for key in keys:
        yield (*path, key)
        yield from places(content[key], (*path, key))


@settings(max_examples=150, deadline=None, suppress_health_check=list(HealthCheck))
@given(data=st.data())
def test_any_value_in_any_place_of_a_manifest_is_taken_or_refused_in_one_line(made, tmp_path_factory, data):
    manifest = json.loads((made / "manifest.json").read_text())
    path = data.draw(st.sampled_from(sorted(places(manifest), key=str)))
    inside = manifest
    for key in path[:-1]:
        inside = inside[key]
    inside[path[-1]] = data.draw(JSON)
    sums = dict(line.split("  ")[::-1] for line in (made / CHECKSUMS).read_text().splitlines())
    content = json.dumps(manifest).encode()
    sums["manifest.json"] = hashlib.sha256(content).hexdigest()
    with pytest.MonkeyPatch.context() as patch:  # the graphs stay where they are
        patch.setattr(
            bundles,
            "_read",
            lambda folder, name, sums: content if name == "manifest.json" else READ(folder, name, sums),
        )
        try:
            found = load_bundle(made)
        except RuntimeFault as fault:
            assert "\n" not in str(fault)
        else:
            for policy in found.policies.values():
                assert (policy.kp <= machine.LARGEST_KP).all()
                assert np.isfinite([policy.kp, policy.kd, policy.scale, policy.pose]).all()


def test_a_graph_that_is_none_is_refused(change, bundle):
    (bundle / "policies" / "00-walk.onnx").write_bytes(b"\x08\x01 no graph")
    with pytest.raises(RuntimeFault, match="onnxruntime does not take it"):
        load_bundle(change(lambda manifest: None))


def test_a_graph_that_gives_no_numbers_is_refused_before_the_robot_stands(change, bundle):
    path = bundle / "policies" / "00-walk.onnx"
    model = onnx.load(path)
    bias = next(one for one in model.graph.initializer if list(one.dims) == [12])
    bias.CopyFrom(onnx.numpy_helper.from_array(np.full(12, np.nan, np.float32), bias.name))
    onnx.save(model, path)
    change(lambda manifest: None)
    with pytest.raises(RuntimeFault, match=r"00-walk.onnx: its action .* is \[\[nan .* expected 12 finite numbers"):
        load_bundle(bundle)


def test_a_computer_without_numpy_is_told_what_to_install(bundle):
    """-S: nothing that was installed is found."""
    command = [sys.executable, "-S", "-m", "hts_go1_runtime", "check", str(bundle)]
    places = {"PYTHONPATH": str(Path(machine.__file__).parents[1])}
    done = subprocess.run(command, env=places, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (2, "")
    (line,) = done.stderr.splitlines()
    assert line == "refused: No module named 'numpy'. It is needed beside this package: pip install numpy onnxruntime"


def test_numbers_of_a_graph_that_lie_in_another_file_are_not_read(change, bundle, tmp_path, monkeypatch):
    """onnxruntime would take them from the working directory, which no checksum of the bundle covers."""
    import onnx

    path = bundle / "policies" / "00-walk.onnx"
    graph = onnx.load(path)
    moved = max(graph.graph.initializer, key=lambda one: len(one.raw_data))
    monkeypatch.chdir(tmp_path)
    (tmp_path / "elsewhere.bin").write_bytes(moved.raw_data)
    moved.ClearField("raw_data")
    moved.data_location = onnx.TensorProto.EXTERNAL
    moved.external_data.add(key="location", value="elsewhere.bin")
    path.write_bytes(graph.SerializeToString())
    with pytest.raises(RuntimeFault, match="onnxruntime does not take it"):
        load_bundle(change(lambda manifest: None))


def test_a_policy_computes_what_hts_computes_from_the_same_readings(bundle):
    import numpy as np

    from hts.policies.deploy import DeployedPolicy
    from hts_go1_runtime.fake import standing

    ours, theirs = (
        load_bundle(bundle).policies["policies/00-walk.onnx"],
        DeployedPolicy(bundle / "policies/00-walk.onnx"),
    )
    rng = np.random.default_rng(0)
    for number in range(5):  # the last action is remembered
        state = standing(number, 0.0)
        state.q[:] += 0.1 * rng.standard_normal(12)
        state.dq[:] = rng.standard_normal(12)
        command = np.array([0.5, 0.0, 0.1])
        readings = {
            "angular_velocity": state.gyro,
            "projected_gravity": state.gravity,
            "command": command,
            "joint_position": state.q,
            "joint_velocity": state.dq,
        }
        expected = theirs.targets({name: value[None] for name, value in readings.items()})[0]
        np.testing.assert_allclose(ours.targets(state, command), expected, atol=1e-5)


def test_the_runtime_imports_neither_hts_nor_torch(bundle):
    """In a process in which hts and its libraries cannot be imported at all."""
    code = """
import sys
class Nobody:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in {"hts", "torch", "mujoco", "onnx", "scipy", "zarr", "yaml", "pydantic"}:
            raise ImportError(name)
sys.meta_path.insert(0, Nobody())
from hts_go1_runtime import bench, cli, fake, session
code = cli.main(["check", sys.argv[1]])
print(sorted({name.split(".")[0] for name in sys.modules} & {"hts", "torch", "mujoco", "onnx"}))
sys.exit(code)
"""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(part for part in sys.path if part)}
    done = subprocess.run(
        [sys.executable, "-c", code, str(bundle)], env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1] == "[]"
    assert "2 rows, 2 s, 50 Hz" in done.stdout


def test_the_checksums_are_those_of_sha256sum(bundle):
    done = subprocess.run(["sha256sum", "-c", "SHA256SUMS"], cwd=bundle, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout
    assert {"manifest.json", "plan.json", "README.md"} <= {line.split(":")[0] for line in done.stdout.splitlines()}


def test_the_manifest_says_what_the_policy_was_trained_with(bundle):
    manifest = json.loads((bundle / "manifest.json").read_text())
    first, second = manifest["policies"]
    assert first["trained"]["delay_s"] == [0.0, 0.015]  # 0 to 3 steps of 5 ms
    assert first["trained"]["commands"]["vx"] == [-1.5, 1.5]
    assert (first["exploration"], first["mean_file"], first["gate"]) == (None, None, None)
    assert second["exploration"]["sigma"] == [0.05] * 12
    assert (bundle / second["mean_file"]).is_file()
    assert manifest["robot"]["position_limit"][2] == [-2.818, -0.888]


def test_a_bundle_for_a_robot_of_another_name_is_told_and_not_refused(bundle, change, capsys):
    assert main(["check", str(bundle)]) == 0
    assert "made for the robot" not in capsys.readouterr().out
    change(lambda m: m["robot"].__setitem__("name", "go1_heavy"))
    assert main(["check", str(bundle)]) == 0
    assert "made for the robot 'go1_heavy', not for a Go1: go on only if it is one" in capsys.readouterr().out
