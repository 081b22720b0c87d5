"""The world `field`: bundles out, logs in."""

from __future__ import annotations

import json
import shutil

import pytest
import yaml
from field_folder import SECONDS, bundle, field, fill_in, write_log

from hts.config import ScheduleConfig
from hts.contracts import WorldContext
from hts.errors import ConfigError, RecordingError, WaitingForRobot
from hts.worlds.base import walking
from hts.worlds.field import make_field


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


def test_a_gauge_that_counts_in_another_unit_is_read_in_the_objectives(run, policy, robot):
    with pytest.raises(WaitingForRobot):
        field(run).collect([policy], walking(0.5, SECONDS))
    fill_in(run)
    path = run / "field" / "mapping.yaml"
    mapping = yaml.safe_load(path.read_text())
    mapping["channels"]["battery_current"] |= {"unit": "mA", "scale": 1000.0, "idle": 1300.0}  # the log is in A
    path.write_text(yaml.safe_dump(mapping))
    write_log(bundle(run) / "logs" / "00.csv", robot)
    (found,) = field(run).collect([policy], walking(0.5, SECONDS))
    assert found.channels["battery_current"].channel.unit == "A"
    assert found.values("battery_current").mean() == pytest.approx(5.0, abs=0.1)
    assert found.idle == field(run).idle() == pytest.approx({"battery_current": 1.3, "battery_voltage": 23.0})
    assert found.notes["units_converted"] == "battery_current mA to A"
    mapping["channels"]["battery_current"]["unit"] = "V"
    path.write_text(yaml.safe_dump(mapping))
    with pytest.raises(
        ConfigError, match=r"^Row 00: \S*mapping.yaml: 'battery_current' is in V, objective 'power' nee"
    ):
        field(run).collect([policy], walking(0.5, SECONDS))
    with pytest.raises(ConfigError, match=r"mapping.yaml: 'battery_current' is in V, objective 'power' needs A"):
        field(run).idle()


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


def test_a_copy_beside_a_log_is_named_with_its_row(run, policy, robot):
    with pytest.raises(WaitingForRobot):
        field(run).collect([policy], walking(0.5, SECONDS))
    fill_in(run)
    logs = bundle(run) / "logs"
    write_log(logs / "00.csv", robot)
    shutil.copy(logs / "00.csv", logs / "00.bak.csv")
    with pytest.raises(
        ConfigError, match=r"^Row 00: .*mapping\.yaml: .* 2 files for .*/00\.bak\.csv, .*/00\.csv\. Take"
    ):
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


def test_what_to_type_next_is_what_asked_and_may_be_pasted_into_a_shell(run, policy):
    command = "hts evaluate 'my run' --speed 0.5 --policy 00-00 --world field --seed 3 --sessions 2"
    context = WorldContext("go1", {}, {"power": {}}, 0, run, command=command)
    world = make_field({"block_seconds": SECONDS}, context)
    with pytest.raises(WaitingForRobot, match=f"then type: {command}$"):
        world.head_to_head(policy, policy, [0.5])
    assert f"4. Type: `{command}`" in (bundle(run) / "README.md").read_text()
    with pytest.raises(WaitingForRobot, match=f"then type: {command}$"):
        world.idle()


def test_a_folder_with_a_blank_in_its_name_is_quoted(run, policy):
    folder = run / "my run"
    folder.mkdir()
    (folder / "config.yaml").write_text("preset: smoke\n")
    with pytest.raises(WaitingForRobot, match=f"then type: hts resume '{folder}'$"):
        field(folder).collect([policy], walking(0.5, SECONDS))


def without(run, *channels):
    path = run / "field" / "mapping.yaml"
    mapping = yaml.safe_load(path.read_text())
    for channel in channels:
        del mapping["channels"][channel]
    path.write_text(yaml.safe_dump(mapping))


def test_a_mapping_that_lacks_what_a_model_reads_is_told_when_the_first_logs_are_read(run, policy, robot):
    """Stored without it, the data could never be fitted to, and nobody would be asked for them again."""
    with pytest.raises(WaitingForRobot):
        field(run).collect([policy], walking(0.5, SECONDS))
    fill_in(run)
    without(run, "joint_velocity")
    write_log(bundle(run) / "logs" / "00.csv", robot)
    with pytest.raises(ConfigError, match=r"mapping\.yaml: objective 'power' needs 'joint_velocity'"):
        field(run).collect([policy], walking(0.5, SECONDS))


def test_so_is_one_that_lacks_what_a_comparison_is_judged_by(run, policy, robot):
    with pytest.raises(WaitingForRobot):
        field(run).head_to_head(policy, policy, [0.8])
    fill_in(run)
    without(run, "base_velocity")
    for number in range(4):
        write_log(bundle(run) / "logs" / f"{number:02d}.csv", robot)
    with pytest.raises(ConfigError, match=r"mapping\.yaml: 'base_velocity' tells whether the robot did its task"):
        field(run).head_to_head(policy, policy, [0.8])


def test_a_final_is_walked_anew_where_a_trial_walked_the_same_policy_at_the_same_speed(run, policy, robot):
    with pytest.raises(WaitingForRobot):
        field(run).head_to_heads([policy], policy, [0.8])
    fill_in(run)
    for number in range(4):
        write_log(bundle(run) / "logs" / f"{number:02d}.csv", robot)
    assert len(field(run).head_to_heads([policy], policy, [0.8])[0]) == 4
    with pytest.raises(WaitingForRobot, match="4 of 4 logs"):
        field(run).head_to_head(policy, policy, [0.8])


def test_a_head_to_head_of_the_same_policy_under_another_name_has_its_logs_already(run, policy):
    """As the best so far, measured like the final, has that go on to it: a dry run counts one visit for both."""
    best = policy.with_name("best.onnx")
    best.write_bytes(policy.read_bytes())
    for one in (policy, best):
        with pytest.raises(WaitingForRobot):
            field(run).head_to_head(one, policy, [0.8])
    assert len([place for place in (run / "field").iterdir() if place.is_dir()]) == 1


def test_a_fall_is_said_of_the_walk_in_which_it_was_and_few_words_will_do(run, policy, robot):
    schedule = walking(0.5, SECONDS)
    with pytest.raises(WaitingForRobot):
        field(run).collect([policy, policy], schedule)
    fill_in(run)
    logs, path = bundle(run) / "logs", run / "field" / "mapping.yaml"
    write_log(logs / "00.csv", robot)
    write_log(logs / "01.csv", robot, seconds=2.0)
    (logs / "mappings").mkdir()
    (logs / "mappings" / "01.yaml").write_text("recording: {fell: true}\n")
    first, second = field(run).collect([policy, policy], schedule)
    assert (first.fell, second.fell, second.mass_kg) == (False, True, 13.2)
    mapping = yaml.safe_load(path.read_text())
    mapping["recording"]["fell"] = True
    path.write_text(yaml.safe_dump(mapping))
    with pytest.raises(RecordingError, match=r"mapping\.yaml: recording\.fell: is said of all logs.*NN\.yaml"):
        field(run).collect([policy, policy], schedule)
