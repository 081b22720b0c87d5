"""What the world `field` puts into a bundle, and what it reads of one that comes back."""

from __future__ import annotations

import dataclasses
import json
import os
from pathlib import Path

import pytest
import yaml
from field_folder import HOLD, SECONDS, bundle, field, fill_in, holding, write_log

from hts.errors import RecordingError, WaitingForRobot, WorldError
from hts.policies.deploy import DeployedPolicy
from hts.policies.proof import ITEMS
from hts.worlds.base import walking


def exploring(policy: Path, robot) -> Path:
    from hts.policies.export import to_onnx
    from hts.policies.files import Policy, load_policy

    one = load_policy(robot.pretrained_policy())
    card = dataclasses.replace(one.card, exploration_std=(0.05,) * 12, policy_hash="e" * 64)
    return to_onnx(Policy(one.tensors, card), policy.with_name("exploring.onnx"))


def test_a_bundle_says_for_how_long_a_sensor_may_repeat_itself(run, policy):
    with pytest.raises(WaitingForRobot):
        field(run).collect([policy], walking(0.5, SECONDS))
    first = bundle(run)
    assert json.loads((first / "manifest.json").read_text())["frozen"] == {"seen_seconds": 0.1, "real_seconds": 3.0}
    turns = json.loads((first / "manifest.json").read_text())["turns"]
    assert turns == {"column": "phase", "counts": 0, "settle_seconds": 2.0}
    with pytest.raises(WaitingForRobot):
        field(run, frozen_seconds=0.0, frozen_real_seconds=5.0).collect([policy], walking(0.6, SECONDS))
    other = next(path for path in first.parent.iterdir() if path.is_dir() and path != first)
    assert json.loads((other / "manifest.json").read_text())["frozen"] == {"seen_seconds": 0.0, "real_seconds": 5.0}


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
    found = {"passed": True, "policy_hash": DeployedPolicy(policy).card.policy_hash}
    policy.with_suffix(".gate.json").write_text(json.dumps(found))
    with pytest.raises(WaitingForRobot):
        holding(run).head_to_head(policy, policy, [0.8])
    manifest = json.loads((bundle(run) / "manifest.json").read_text())
    assert manifest["policies"][0]["gate"] == found
    assert manifest["policies"][0]["trained"]["source"] == "card of the policy"  # what it says of itself comes first
    assert manifest["hold"] == {"commands": [0.4, 1.2], "seconds": 12.0, "tolerance": 0.01}
    assert manifest["warmup_seconds"] == 600.0 and "for 10 minutes" in (bundle(run) / "README.md").read_text()
    assert manifest["channels"]["battery_current"] == {"unit": "A", "size": 0, "real": True}
    text = (bundle(run) / "README.md").read_text()
    assert "## When to stop" in text
    assert "40% of the speed with the torque limited to\n70%" in text
    assert manifest["first_runs"] == {"speed_scale": 0.4, "torque_scale": 0.7, "seconds": 20.0}


def test_a_bundle_of_first_data_asks_for_no_warm_up(run, policy):
    with pytest.raises(WaitingForRobot):
        field(run).collect([policy], walking(0.5, SECONDS))
    assert json.loads((bundle(run) / "manifest.json").read_text())["warmup_seconds"] == 0.0
    assert "Warm the robot up" not in (bundle(run) / "README.md").read_text()


def test_a_bundle_names_the_runtime_that_the_robots_package_brings(run, policy, robot):
    with pytest.raises(WaitingForRobot):
        field(run).collect([policy], walking(0.5, SECONDS))
    text = (bundle(run) / "README.md").read_text()
    assert "of step 2 at most the weight is left (`mass_kg`)" in text  # `hts resume` asks for it
    assert "about 2 m, straight on" in text  # 3 s at 0.5 m/s
    assert robot.bundle_commands  # and each is there to be typed
    assert all(f"    {command}\n" in text for command in robot.bundle_commands)
    assert "What your runner has to do" not in text


def test_the_page_says_how_far_the_robot_walks(run, policy):
    """Ten minutes of warming up, four blocks, and a trim of each policy, all at 0.8 m/s."""
    world = holding(run)
    with pytest.raises(WaitingForRobot):
        world.head_to_head(policy, policy, [0.8])
    expected = 0.8 * (600 + 4 * SECONDS + 2 * HOLD.seconds)
    assert f"about {expected:.0f} m, straight on" in (bundle(run) / "README.md").read_text()


def test_a_bundle_without_a_runtime_has_the_loop_of_each_kind_of_policy(robot):
    """Joint targets of a velocity robot; a policy with a past and other gains has a loop of its own."""
    from hts.worlds.field_runner import runner

    spec = robot.spec
    entry = {
        "file": "policies/00-a.onnx",
        "joint_names": list(spec.joint_names),
        "default_pose": list(spec.default_pose),
        "action_scale": [0.25] * 12,
        "kp": [30.0] * 12,
        "kd": [0.5] * 12,
        "control_rate_hz": 50.0,
        "observation": [
            {"name": "angular_velocity", "size": 3, "unit": "rad/s", "meaning": "of the trunk"},
            {"name": "joint_velocity", "size": 12, "unit": "rad/s", "meaning": "joint speed"},
        ],
        "history": 1,
    }
    first = {"speed_scale": 0.5, "torque_scale": 0.7, "seconds": 20.0}
    alone = runner(spec, [entry, {**entry, "file": "policies/01-b.onnx"}], first, walks=True, own_env=False)
    assert alone.count("**Loop.** 50 times a second, each 20 ms") == 1 and "###" not in alone
    assert "| 0 | 2 | angular_velocity | rad/s | of the trunk |\n| 3 | 14 | joint_velocity |" in alone
    assert "**Actions.** An action moves the joints' targets: joint target, rad = default_pose" in alone
    assert "70% of it, at 50% of the command, for 20 s" in alone and "the trunk leans too far" in alone
    assert "Write `only: {column: phase}` into the mapping" in alone
    assert alone.count("| 0.25 | 30 | 0.5 |") == 12
    other = {**entry, "file": "policies/01-b.onnx", "history": 3, "kp": [20.0] * 12}
    both = runner(spec, [entry, other], first, walks=True, own_env=False)
    assert "### `policies/00-a.onnx`" in both and "### `policies/01-b.onnx`" in both
    assert "float32 (1, 45)" in both and "The last 3 of them" in both
    assert both.count("| 0.25 | 20 | 0.5 |") == 12


def test_a_delay_in_shares_of_a_control_step_is_told_in_seconds(robot):
    from types import SimpleNamespace

    from hts.worlds.field_manifest import _trained

    ranges = {"delay_steps": [0, 3], "delay_share": [0.5, 1.0]}
    card = SimpleNamespace(made={"config": {"env": {"randomisation": ranges, "commands": {}}}})
    told = _trained(card, SimpleNamespace(run=None, spec=robot.spec))
    assert told["delay_s"] == pytest.approx((0.01, 0.02))  # a control step of 20 ms
    del ranges["delay_share"]
    two = SimpleNamespace(physics_dt=0.005, substeps=2)  # the default, 0 to 3, ends with a control step
    assert _trained(card, SimpleNamespace(run=None, spec=two))["delay_s"] == pytest.approx((0.0, 0.01))


@pytest.mark.parametrize(("made", "known"), [({"anchor": "0" * 64}, True), ({"kind": "rsl_rl"}, False), ({}, False)])
def test_ranges_of_the_run_are_those_of_what_was_fine_tuned_and_of_nothing_else(robot, made, known):
    from types import SimpleNamespace

    from hts.worlds.field_manifest import _trained

    env = {"randomisation": {"delay_steps": [0, 3]}, "commands": {"vx": [0.2, 1.5]}}
    told = _trained(SimpleNamespace(made=made), SimpleNamespace(run={"finetune": {"env": env}}, spec=robot.spec))
    assert (told is not None) == known
    assert not known or (told["commands"], told["source"]) == ({"vx": [0.2, 1.5]}, "run that fine-tuned it")


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


def test_a_run_from_a_policy_that_nobody_vouches_for_is_refused_before_anything_is_spent(tmp_path, robot, capsys):
    from hts.cli.main import main
    from hts.policies.files import Policy, load_policy, save_policy

    pretrained = load_policy(robot.pretrained_policy())
    proof = {item: {"state": "proven", "why": "a log", "by": ""} for item in ITEMS}

    def dry_run(states):
        card = dataclasses.replace(pretrained.card, made={"kind": "rsl_rl", "proof": states})
        start = save_policy(tmp_path / "mine", Policy(pretrained.tensors, card))
        given = ["--objective", "power", "--robot", "go1", "--world", "field", "--preset", "smoke", "--dry-run"]
        code = main(["run", *given, "--set", f"robot.policy={start}"])
        return code, " ".join(capsys.readouterr().err.split())

    code, said = dry_run({**proof, "delay": {"state": "not proven", "why": "no log"}})
    assert code == 2
    assert "mine.safetensors: comes from elsewhere, and nobody has shown or vouched for its delay. It is not" in said
    assert "(--accept ITEM --by NAME)" in said


def test_a_start_that_somebody_vouches_for_is_as_good_as_one_that_was_trained_here(tmp_path, robot):
    from hts.contracts import WorldContext
    from hts.policies.files import Policy, load_policy, save_policy
    from hts.worlds.field import make_field

    pretrained = load_policy(robot.pretrained_policy())
    proof = {item: {"state": "accepted", "why": "no log", "by": "Ada Lovelace"} for item in ITEMS}
    card = dataclasses.replace(pretrained.card, made={"kind": "rsl_rl", "proof": proof})
    start = save_policy(tmp_path / "mine", Policy(pretrained.tensors, card))
    make_field({}, WorldContext("go1", {"policy": start}, {"power": {}}, 0, tmp_path)).check()


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


@pytest.fixture
def self_described(run, policy, robot):
    """described(change): a log beside which lies a mapping, changed by change(mapping); then the world is asked."""
    with pytest.raises(WaitingForRobot):
        field(run).collect([policy], walking(0.5, SECONDS))
    mapping = yaml.safe_load((run / "field" / "mapping.yaml").read_text())
    mapping["channels"]["battery_current"]["idle"] = 1.1
    mapping["channels"]["battery_voltage"]["idle"] = 23.5
    mapping["recording"] = {"mass_kg": 12.5}
    place = bundle(run) / "logs" / "mappings" / "00.yaml"
    place.parent.mkdir()

    def described(change=lambda mapping: None, seconds=SECONDS):
        change(mapping)
        place.write_text(yaml.safe_dump(mapping))
        write_log(bundle(run) / "logs" / "00.csv", robot, seconds)
        return field(run).collect([policy], walking(0.5, SECONDS))[0]

    return described


def test_an_empty_mass_of_the_runs_own_mapping_is_asked_for_beside_a_log_that_does_not_know_it(run, self_described):
    with pytest.raises(RecordingError, match=r"field/mapping.yaml: recording.mass_kg is still empty"):
        self_described(lambda mapping: mapping["recording"].pop("mass_kg"))
    fill_in(run)
    assert self_described().mass_kg == 13.2


def test_a_level_that_was_measured_by_hand_wins_over_one_that_is_no_number(run, self_described):
    def spoil(mapping):
        mapping["channels"]["battery_current"]["idle"] = "NaN"

    with pytest.raises(RecordingError, match=r"00.yaml: channels.battery_current.idle: expected a number"):
        self_described(spoil)
    fill_in(run)
    assert self_described(spoil).idle["battery_current"] == 1.3


@pytest.mark.parametrize("key", ["files", "level"])
def test_another_sensor_in_the_runs_own_mapping_is_refused_rather_than_passed_over(run, self_described, key):
    path = run / "field" / "mapping.yaml"
    own = yaml.safe_load(path.read_text())
    if key == "files":
        own["files"] = {"state": "00.csv", "gauge": "*gauge*"}
    else:
        own["channels"]["sound_level"] = {"columns": "level", "unit": "dB", "idle": 38.0}
    path.write_text(yaml.safe_dump(own))
    said = "`files`" if key == "files" else "an idle level of 'sound_level'"
    with pytest.raises(RecordingError, match=rf"field/mapping.yaml: says {said}, but the log has a mapping of its own"):
        self_described()


@pytest.mark.parametrize(
    ("stated", "said"),
    [
        ({"session": "abcdef012345"}, r"session 'abcdef012345', not [0-9a-f]{12}"),
        ({"block": 2}, r"block 2, not 0"),
        ({"role": "policy"}, r"role 'policy', not collection"),
        ({"schedule": {"commands": [{"seconds": SECONDS, "vx": 0.8}]}}, r"commands \[.*0\.8.*\], not \[.*0\.5.*\]"),
    ],
)
def test_a_log_that_says_it_is_of_another_row_or_bundle_is_refused(self_described, stated, said):
    """The pretrained policy walks in every bundle, so its hash alone does not tell."""
    with pytest.raises(
        RecordingError, match=rf"00.yaml: says that its log is of {said}, as is asked for here"
    ) as caught:
        self_described(lambda mapping: mapping["recording"].update(stated))
    assert "\n" not in str(caught.value)


def test_a_log_that_says_it_is_of_this_row_is_read(run, self_described):
    row = json.loads((bundle(run) / "manifest.json").read_text())["rows"][0]
    stated = {key: row[key] for key in ("session", "block", "role")}
    stated["schedule"] = {"commands": [{"seconds": SECONDS, "vx": 0.5, "vy": 0.0, "yaw_rate": 0.0}]}
    assert self_described(lambda mapping: mapping["recording"].update(stated)).session == row["session"]


def test_what_the_runs_own_mapping_says_of_a_row_is_no_word_about_the_log(run, self_described):
    fill_in(run)
    own = run / "field" / "mapping.yaml"
    mapping = yaml.safe_load(own.read_text())
    mapping["recording"] |= {"session": "monday", "role": "policy"}
    own.write_text(yaml.safe_dump(mapping))
    row = json.loads((bundle(run) / "manifest.json").read_text())["rows"][0]
    found = self_described()
    assert (found.session, found.role) == (row["session"], row["role"])


def test_a_log_that_ends_in_a_fall_may_be_shorter_than_its_row(self_described):
    with pytest.raises(RecordingError, match=r"1.0 s long, but 3 s were to be recorded.*recording.fell: true in"):
        self_described(seconds=1.0)
    found = self_described(lambda mapping: mapping["recording"].update(fell=True), seconds=1.0)
    assert found.fell and found.seconds == pytest.approx(1.0, abs=0.05)
    with pytest.raises(RecordingError, match=r"5.0 s long, but 3 s were to be recorded"):
        self_described(seconds=5.0)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"recording": 3}, r"recording: expected keys and values \(such as mass_kg: 13.2\), found 3\."),
        ({"recording": [3]}, r"recording: expected keys and values .*, found \[3\]\."),
        ({"recording": {"kp": 3}}, r"recording\.kp: expected a list of one gain a joint, N\*m/rad, found 3\."),
        ({"channels": [1]}, r"channels: expected keys and values .*, found \[1\]\."),
        ({"channels": {"battery_current": 4}}, r"channels\.battery_current: expected keys and values .*, found 4\."),
        (
            {"channels": {"battery_current": {"columns": "i", "unit": "A", "idle": "low"}}},
            r"channels\.battery_current\.idle: expected a number, in the channel's unit, found 'low'\.",
        ),
    ],
)
@pytest.mark.parametrize("whose", ["own", "beside"])
def test_a_mapping_that_is_built_wrongly_is_named_with_file_and_key(run, policy, self_described, change, said, whose):
    own, beside = run / "field" / "mapping.yaml", bundle(run) / "logs" / "mappings" / "00.yaml"
    if whose == "own":
        own.write_text(yaml.safe_dump({**yaml.safe_load(own.read_text()), **change}))
    with pytest.raises(RecordingError, match=rf"{own if whose == 'own' else beside}: {said}") as caught:
        self_described(lambda mapping: mapping.update(change) if whose == "beside" else None)
    assert "\n" not in str(caught.value)


def test_a_bundle_is_on_the_disk_before_it_has_its_name(run, policy, monkeypatch):
    order, fsync, rename = [], os.fsync, os.rename

    def synced(handle):
        order.append(Path(os.readlink(f"/proc/self/fd/{handle}")))
        fsync(handle)

    def renamed(old, new):
        order.append("rename")
        rename(old, new)

    monkeypatch.setattr(os, "fsync", synced)
    monkeypatch.setattr(os, "rename", renamed)
    with pytest.raises(WaitingForRobot):
        field(run).collect([policy], walking(0.5, SECONDS))
    found = bundle(run)
    files = {path.relative_to(found) for path in found.rglob("*") if path.is_file()}
    before = order[: order.index("rename")]
    assert len(files) > 5
    assert files <= {path.relative_to(part) for path in before for part in path.parents if part.suffix == ".partial"}
    assert order[-1] == found.parent
