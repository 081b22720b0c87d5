"""The world `field`: bundles out, logs in."""

from __future__ import annotations

import dataclasses
import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from hts.config import ScheduleConfig
from hts.contracts import HoldSpeed, WorldContext
from hts.errors import ConfigError, RecordingError, WaitingForRobot, WorldError
from hts.policies.deploy import DeployedPolicy
from hts.policies.proof import ITEMS
from hts.worlds.base import walking
from hts.worlds.field import make_field

SECONDS = 3.0


@pytest.fixture
def run(tmp_path) -> Path:
    (tmp_path / "config.yaml").write_text("preset: smoke\n")
    return tmp_path


@pytest.fixture
def policy(tmp_path, robot) -> Path:
    from hts.policies.export import to_onnx
    from hts.policies.files import load_policy

    return to_onnx(load_policy(robot.pretrained_policy()), tmp_path / "walk.onnx")


def field(run: Path, **settings):
    context = WorldContext("go1", {}, {"power": {}}, 0, run)
    return make_field({"block_seconds": SECONDS, **settings}, context)


def write_log(path: Path, robot, seconds: float = SECONDS, command: float | np.ndarray | None = None) -> None:
    """A log whose columns are named as the template names them. command: forward, m/s; None: noise."""
    rng, steps = np.random.default_rng(list(path.name.encode())), round(seconds * 50)  # no two rows are alike
    columns: dict[str, np.ndarray] = {"time": np.arange(steps) / 50}
    for name, channel in robot.channels().items():
        for i in range(channel.shape[0]):
            centre = robot.spec.default_pose[i] if name in ("joint_position", "joint_target") else 0.0
            label = (
                f"{robot.spec.joint_names[i]}_{name.removeprefix('joint_')}"
                if name.startswith("joint_")
                else f"{name}_{i}"
            )
            columns[label] = centre + 0.05 * rng.standard_normal(steps)
    gravity = [columns[f"projected_gravity_{i}"] for i in range(3)]
    gravity[2] -= 1.0
    length = np.sqrt(sum(part**2 for part in gravity))
    for i, part in enumerate(gravity):
        columns[f"projected_gravity_{i}"] = part / length
    if command is not None:
        columns["command_0"] = np.broadcast_to(command, steps)
    columns["battery_voltage"] = 22.0 + 0.1 * rng.standard_normal(steps)
    columns["battery_current"] = 5.0 + 0.1 * rng.standard_normal(steps)
    rows = np.stack(list(columns.values()), axis=1)
    np.savetxt(path, rows, delimiter=",", header=",".join(columns), comments="", fmt="%.6f")


def bundle(run: Path) -> Path:
    return next(path for path in (run / "field").iterdir() if path.is_dir())


def fill_in(run: Path) -> None:
    path = run / "field" / "mapping.yaml"
    mapping = yaml.safe_load(path.read_text())
    mapping["channels"]["battery_current"]["idle"] = 1.3
    mapping["channels"]["battery_voltage"]["idle"] = 23.0
    mapping["recording"]["mass_kg"] = 13.2
    path.write_text(yaml.safe_dump(mapping))


def test_a_request_writes_a_bundle_and_waits_with_the_command_to_type(run, policy):
    with pytest.raises(WaitingForRobot, match=f"hts resume {run}$") as waiting:
        field(run).collect([policy, policy], walking(0.5, SECONDS))
    assert waiting.value.exit_code == 75
    found = bundle(run)
    card = json.loads((found / "policies" / "00-walk.json").read_text())
    assert {"joint_names", "default_pose", "kp", "kd", "action_scale", "observation"} <= set(card)
    assert [row["log"] for row in json.loads((found / "plan.json").read_text())] == ["00", "01"]
    assert "0.5 m/s for 3 s" in (found / "README.md").read_text()
    assert yaml.safe_load((run / "field" / "mapping.yaml").read_text())["channels"]["battery_current"]["idle"] is None


def test_when_the_logs_are_in_the_same_request_goes_on(run, policy, robot):
    schedule: ScheduleConfig = walking(0.5, SECONDS)
    with pytest.raises(WaitingForRobot):
        field(run).collect([policy, policy], schedule)
    fill_in(run)
    write_log(bundle(run) / "logs" / "00.csv", robot)
    with pytest.raises(WaitingForRobot, match="1 of 2 logs"):
        field(run).collect([policy, policy], schedule)
    write_log(bundle(run) / "logs" / "01.csv", robot)
    first, second = field(run).collect([policy, policy], schedule)
    assert (first.world, first.role, first.mass_kg, first.schedule) == ("field", "collection", 13.2, schedule)
    assert first.idle == {"battery_current": 1.3, "battery_voltage": 23.0}
    assert first.session != second.session
    assert field(run).idle() == {"battery_current": 1.3, "battery_voltage": 23.0}


def test_a_head_to_head_asks_for_its_blocks_in_the_order_that_cancels_drift(run, policy, robot):
    with pytest.raises(WaitingForRobot, match="4 of 4 logs"):
        field(run).head_to_head(policy, policy, [0.8])
    fill_in(run)
    for number in range(4):
        write_log(bundle(run) / "logs" / f"{number:02d}.csv", robot)
    recordings = field(run).head_to_head(policy, policy, [0.8])
    assert [recording.role for recording in recordings] == ["reference", "policy", "policy", "reference"]
    assert [recording.block for recording in recordings] == [0, 1, 2, 3]
    assert len({recording.session for recording in recordings}) == 1


def test_a_mass_that_nobody_filled_in_is_asked_for_before_anything_is_learned(run, policy, robot):
    with pytest.raises(WaitingForRobot):
        field(run).collect([policy], walking(0.5, SECONDS))
    fill_in(run)
    path = run / "field" / "mapping.yaml"
    mapping = yaml.safe_load(path.read_text())
    path.write_text(yaml.safe_dump(mapping | {"recording": {"mass_kg": None}}))
    write_log(bundle(run) / "logs" / "00.csv", robot)
    with pytest.raises(RecordingError, match=r"mapping\.yaml: recording\.mass_kg is still empty\. Weigh the robot"):
        field(run).collect([policy], walking(0.5, SECONDS))
    path.write_text(yaml.safe_dump({key: value for key, value in mapping.items() if key != "recording"}))
    assert field(run).collect([policy], walking(0.5, SECONDS))[0].mass_kg is None


def test_one_log_under_two_names_is_refused(run, policy, robot):
    with pytest.raises(WaitingForRobot, match="4 of 4 logs"):
        field(run).head_to_head(policy, policy, [0.8])
    fill_in(run)
    logs = bundle(run) / "logs"
    for number in range(4):
        write_log(logs / f"{number:02d}.csv", robot)
    shutil.copy(logs / "01.csv", logs / "02.csv")
    with pytest.raises(RecordingError, match=r"02\.csv: the same samples as 01\.csv"):
        field(run).head_to_head(policy, policy, [0.8])


def test_idle_levels_are_waited_for_until_somebody_has_read_them_off(run):
    with pytest.raises(WaitingForRobot, match="idle level of battery_current, battery_voltage"):
        field(run).idle()


def test_a_log_of_the_wrong_length_is_refused(run, policy, robot):
    with pytest.raises(WaitingForRobot):
        field(run).collect([policy], walking(0.5, SECONDS))
    fill_in(run)
    write_log(bundle(run) / "logs" / "00.csv", robot, seconds=5.0)
    with pytest.raises(RecordingError, match=r"00.csv: 5.0 s long, but 3 s"):
        field(run).collect([policy], walking(0.5, SECONDS))


def test_a_mapping_with_a_misspelt_key_is_named_with_its_file(run, policy, robot):
    with pytest.raises(WaitingForRobot):
        field(run).collect([policy], walking(0.5, SECONDS))
    fill_in(run)
    path = run / "field" / "mapping.yaml"
    path.write_text(path.read_text().replace("rate_hz", "rate_herz"))
    write_log(bundle(run) / "logs" / "00.csv", robot)
    with pytest.raises(ConfigError, match=r"mapping.yaml: .*rate_h"):
        field(run).collect([policy], walking(0.5, SECONDS))


def test_each_round_of_a_race_is_one_bundle_and_its_policies_share_the_reference(run, policy, robot):
    asked = ([policy, policy], policy, 0.8)
    with pytest.raises(WaitingForRobot, match="6 of 6 logs"):
        field(run).head_to_head_round(*asked, 0, SECONDS)
    first = bundle(run)
    plan = json.loads((first / "plan.json").read_text())
    assert [row["role"] for row in plan] == ["reference", "policy", "policy", "policy", "policy", "reference"]
    assert len({row["session"] for row in plan}) == 1
    fill_in(run)
    for number in range(6):
        write_log(first / "logs" / f"{number:02d}.csv", robot)
    rows = field(run).head_to_head_round(*asked, 0, SECONDS)
    assert [[recording.block for recording in row] for row in rows] == [[0, 1, 4, 5], [0, 2, 3, 5]]
    assert rows[0][0] is rows[1][0]
    with pytest.raises(WaitingForRobot, match="6 of 6 logs"):
        field(run).head_to_head_round(*asked, 1, SECONDS)
    assert len([path for path in first.parent.iterdir() if path.is_dir()]) == 2


# ------------------------------------------------------------------------------------------------ the bundle


def exploring(policy: Path, robot) -> Path:
    from hts.policies.export import to_onnx
    from hts.policies.files import Policy, load_policy

    one = load_policy(robot.pretrained_policy())
    card = dataclasses.replace(one.card, exploration_std=(0.05,) * 12, policy_hash="e" * 64)
    return to_onnx(Policy(one.tensors, card), policy.with_name("exploring.onnx"))


def test_each_exploring_row_has_a_graph_of_its_own_with_a_noise_of_its_own(run, policy, robot):
    noisy = exploring(policy, robot)
    with pytest.raises(WaitingForRobot):
        field(run).collect([policy, policy, noisy, noisy], walking(0.5, SECONDS))
    manifest = json.loads((bundle(run) / "manifest.json").read_text())
    files = [row["policy"] for row in manifest["rows"]]
    assert files[0] == files[1]
    assert len(set(files)) == 3
    plain, first, second = manifest["policies"]
    assert plain["exploration"] is None
    assert first["exploration"]["seed"] != second["exploration"]["seed"]
    assert first["mean_file"] == second["mean_file"] == "policies/mean/exploring.onnx"
    assert json.loads((bundle(run) / files[2]).with_suffix(".json").read_text())["exploration"] == "in the graph"


def test_a_bundle_knows_what_its_run_trained_with_and_what_the_gate_found(run, policy):
    (run / "config.yaml").write_text(
        "finetune: {env: {randomisation: {delay_steps: [1, 2]}, commands: {vx: [0.2, 1.5]}}}\n"
        "gate: {first_run: {speed_scale: 0.4}}\n"
    )
    policy.with_suffix(".gate.json").write_text('{"passed": true}')
    with pytest.raises(WaitingForRobot):
        holding(run).head_to_head(policy, policy, [0.8])
    manifest = json.loads((bundle(run) / "manifest.json").read_text())
    assert manifest["policies"][0]["gate"] == {"passed": True}
    assert manifest["policies"][0]["trained"]["source"] == "card of the policy"  # what it says of itself comes first
    assert manifest["hold"] == {"commands": [0.4, 1.2], "seconds": 12.0, "tolerance": 0.01}
    assert manifest["warmup_seconds"] == 600.0
    assert manifest["channels"]["battery_current"] == {"unit": "A", "size": 0, "real": True}
    text = (bundle(run) / "README.md").read_text()
    assert "## When to stop" in text
    assert "40% of the speed with the torque limited to\n70%" in text
    assert manifest["first_runs"] == {"speed_scale": 0.4, "torque_scale": 0.7, "seconds": 20.0}


def test_a_delay_in_shares_of_a_control_step_is_told_in_seconds(robot):
    from types import SimpleNamespace

    from hts.worlds.field_manifest import _trained

    ranges = {"delay_steps": [0, 3], "delay_share": [0.5, 1.0]}
    card = SimpleNamespace(made={"config": {"env": {"randomisation": ranges, "commands": {}}}})
    told = _trained(card, SimpleNamespace(run=None, spec=robot.spec))
    assert told["delay_s"] == pytest.approx((0.01, 0.02))  # a control step of 20 ms


def test_a_policy_that_nobody_vouches_for_is_not_bundled(run, tmp_path, robot):
    from hts.policies.export import to_onnx
    from hts.policies.files import load_policy

    pretrained = load_policy(robot.pretrained_policy())
    proof = {item: {"state": "proven", "why": "a log", "by": ""} for item in ITEMS}

    def walk(states):
        card = dataclasses.replace(pretrained.card, made={"kind": "rsl_rl", "proof": states})
        return to_onnx(dataclasses.replace(pretrained, card=card), tmp_path / "walk.onnx")

    doubtful = {"gains": {"state": "differs", "why": "kp"}, "delay": {"state": "not proven", "why": "no log"}}
    foreign = walk({**proof, **doubtful})
    with pytest.raises(WorldError, match=r"shown or vouched for its gains, delay\. It is not bundled.*--accept ITEM"):
        field(run).collect([foreign], walking(0.5, SECONDS))
    assert not list(run.rglob("policies"))  # nor half of it
    with pytest.raises(WaitingForRobot):
        field(run).collect([walk(proof)], walking(0.5, SECONDS))


def test_a_bundle_of_before_is_left_as_it_is_and_read(run, policy, robot):
    with pytest.raises(WaitingForRobot):
        field(run).collect([policy], walking(0.5, SECONDS))
    fill_in(run)
    for name in ("manifest.json", "SHA256SUMS"):  # it had neither
        (bundle(run) / name).unlink()
    write_log(bundle(run) / "logs" / "00.csv", robot)
    (found,) = field(run).collect([policy], walking(0.5, SECONDS))
    assert found.idle == {"battery_current": 1.3, "battery_voltage": 23.0}
    assert not (bundle(run) / "manifest.json").exists()


def test_a_log_that_describes_itself_needs_no_filled_in_mapping(run, policy, robot):
    with pytest.raises(WaitingForRobot):
        field(run).collect([policy], walking(0.5, SECONDS))
    described = yaml.safe_load((run / "field" / "mapping.yaml").read_text())
    described["channels"]["battery_current"]["idle"] = 1.1
    described["channels"]["battery_voltage"]["idle"] = 23.5
    own = described["recording"] = {"clock": "monotonic", "policy_hash": "f" * 64, "mass_kg": 12.5}
    logs = bundle(run) / "logs"
    (logs / "mappings").mkdir()
    (logs / "mappings" / "00.yaml").write_text(yaml.safe_dump(described))
    write_log(logs / "00.csv", robot)
    with pytest.raises(RecordingError, match=r"00.yaml: policy ffffffffffff… ran, asked for was walk.onnx"):
        field(run).collect([policy], walking(0.5, SECONDS))
    own["policy_hash"] = DeployedPolicy(policy).card.policy_hash
    own["kp"] = [20.0] * 12
    (logs / "mappings" / "00.yaml").write_text(yaml.safe_dump(described))
    with pytest.raises(RecordingError, match=r"00.yaml: kp \[20.0, .* walk.onnx was trained with \[30.0"):
        field(run).collect([policy], walking(0.5, SECONDS))
    own["kp"] = [30.0] * 12
    (logs / "mappings" / "00.yaml").write_text(yaml.safe_dump(described))
    (found,) = field(run).collect([policy], walking(0.5, SECONDS))
    assert (found.clock, found.mass_kg) == ("monotonic", 12.5)
    assert found.idle == {"battery_current": 1.1, "battery_voltage": 23.5}
    fill_in(run)  # what a person has measured wins
    (found,) = field(run).collect([policy], walking(0.5, SECONDS))
    assert found.idle == {"battery_current": 1.3, "battery_voltage": 23.0}
    assert found.mass_kg == 13.2


# ------------------------------------------------------------------------------------------------ held speed

HOLD = HoldSpeed((0.4, 1.2))


def holding(run: Path, **settings):
    world = field(run, **settings)
    assert world.hold_speed(HOLD)
    return world


def head_to_head_at(run: Path, policy: Path, robot, commands) -> list:
    """Ask, record the four blocks with these commands, ask again."""
    with pytest.raises(WaitingForRobot):
        holding(run).head_to_head(policy, policy, [0.8])
    fill_in(run)
    for number, command in enumerate(commands):
        write_log(bundle(run) / "logs" / f"{number:02d}.csv", robot, command=command)
    return holding(run).head_to_head(policy, policy, [0.8])


def test_a_bundle_says_how_to_trim_and_before_which_rows(run, policy):
    with pytest.raises(WaitingForRobot):
        holding(run).head_to_head(policy, policy, [0.8])
    text = (bundle(run) / "README.md").read_text()
    assert "walk with its policy for 12 s" in text and "between 0.4 and 1.2 m/s" in text
    assert "motion capture" in text and "`base_velocity`" in text
    plan = json.loads((bundle(run) / "plan.json").read_text())
    assert [row["trim"] for row in plan] == [True, True, False, False]
    assert [line.count("trim first") for line in text.splitlines() if line.startswith("| 0")] == [1, 1, 0, 0]
    with pytest.raises(WaitingForRobot):
        field(run).head_to_head(policy, policy, [0.8])
    assert len([path for path in (run / "field").iterdir() if path.is_dir()]) == 2  # another request


def test_a_speed_that_is_walked_again_gets_a_bundle_of_its_own(run, policy, robot):
    head_to_head_at(run, policy, robot, [0.82, 0.85, 0.85, 0.82])
    world = field(run)
    world.hold_speed(replace(HOLD, again=1))
    with pytest.raises(WaitingForRobot):  # and does not read the logs of the first time again
        world.head_to_head(policy, policy, [0.8])


def test_the_frozen_command_is_read_from_the_logs(run, policy, robot):
    recordings = head_to_head_at(run, policy, robot, [0.82, 0.85, 0.85, 0.82])
    assert [float(r.notes["held_command"]) for r in recordings] == pytest.approx([0.82, 0.85, 0.85, 0.82])
    assert {r.notes["held_saturated"] for r in recordings} == {"false"}
    assert {r.schedule.commands[0].vx for r in recordings} == {0.8}
    assert [r.robot_samples for r in recordings] == [750, 750, 150, 150]  # 12 s of trimming before the first of each


def test_a_command_at_the_limit_says_so(run, policy, robot):
    recordings = head_to_head_at(run, policy, robot, [0.82, 1.2, 1.2, 0.82])
    assert [r.notes["held_saturated"] for r in recordings] == ["false", "true", "true", "false"]


@pytest.mark.parametrize(
    ("commands", "words"),
    [
        ([0.82, np.linspace(0.8, 0.85, 150), 0.85, 0.82], "01.csv: the command moves between 0.800 and 0.850"),
        ([0.82, 1.3, 1.3, 0.82], "01.csv: the command is 1.300 m/s, allowed are 0.4 to 1.2"),
        ([0.82, 0.85, 0.87, 0.82], "block 2: the policy got 0.870 m/s after 0.850"),
    ],
)
def test_commands_that_were_not_frozen_are_refused_in_one_line(run, policy, robot, commands, words):
    with pytest.raises(RecordingError, match=words) as error:
        head_to_head_at(run, policy, robot, commands)
    assert "\n" not in str(error.value)


def test_holding_needs_a_mapping_with_the_speed_sensor(run, policy):
    with pytest.raises(WaitingForRobot):
        holding(run).collect([policy], walking(0.5, SECONDS))
    assert "trim" not in (bundle(run) / "README.md").read_text()  # first data are collected as ever
    mapping = yaml.safe_load((run / "field" / "mapping.yaml").read_text())
    del mapping["channels"]["base_velocity"]
    path = run / "mine.yaml"
    path.write_text(yaml.safe_dump(mapping))
    field(run, mapping=path).check()
    with pytest.raises(ConfigError, match="needs the channel 'base_velocity'.*motion capture"):
        holding(run, mapping=path).check()


def test_a_round_at_two_speeds_is_one_bundle(run, policy, robot):
    asked = ([policy], policy, [0.5, 0.8])
    with pytest.raises(WaitingForRobot, match="8 of 8 logs"):
        holding(run).head_to_head_round(*asked, 0, SECONDS)
    fill_in(run)
    for number in range(8):
        command = 0.55 if number < 4 else 0.85
        write_log(bundle(run) / "logs" / f"{number:02d}.csv", robot, command=command)
    (row,) = holding(run).head_to_head_round(*asked, 0, SECONDS)
    assert [r.schedule.commands[0].vx for r in row] == [0.5] * 4 + [0.8] * 4
    assert [r.role for r in row] == ["reference", "policy", "policy", "reference"] * 2
    assert len({r.session for r in row}) == 2
