"""A mapping that is suggested from a log, for every format, with what it cannot tell marked."""

from __future__ import annotations

import importlib.util
from dataclasses import replace

import numpy as np
import pytest
import yaml

from hts.channels import Channel
from hts.contracts import LogOnlyRobot, Task
from hts.errors import ConfigError, RecordingError
from hts.plugins import load
from hts.recordings.csv_reader import make as make_csv
from hts.recordings.mapping import load_mapping
from hts.recordings.suggest import suggested_mapping
from hts.testing.made_up_recordings import CostObjective

STEPS = np.arange(60)
COLUMNS = {
    "timestamp_ms": 1_763_000_000_000 + 20 * STEPS,
    "tau_hip": STEPS / 10,
    "tau_knee": -STEPS / 10,
    "dq_hip": STEPS / 20,
    "dq_knee": -STEPS / 20,
    "supply_a_mean": -2 - STEPS / 100,
    "note_std": STEPS / 7,
}


def csv_of(columns, delimiter=",", decimal="."):
    rows = zip(*(values.tolist() for values in columns.values()), strict=True)
    lines = [delimiter.join(columns), *(delimiter.join(map(str, row)).replace(".", decimal) for row in rows)]
    return "\n".join(lines) + "\n"


def answered(text):
    """The mapping as a person leaves it: the idle level filled in."""
    given = yaml.safe_load(text)
    for channel in given["channels"].values():
        if "idle" in channel:
            channel["idle"] = 1.9
    return given


def test_names_in_a_header_become_a_mapping_that_imports_once_idle_is_answered(tmp_path, two_joints):
    log = tmp_path / "log.csv"
    log.write_text(csv_of(COLUMNS))
    text = suggested_mapping(log, two_joints)
    given = yaml.safe_load(text)
    assert given["time"] == {"column": "timestamp_ms", "unit": "ms"} and given["rate_hz"] == 50
    assert given["channels"]["joint_torque"]["columns"] == "tau_{joint}"
    assert given["channels"]["supply_a_mean"] == {"columns": "supply_a_mean", "unit": "A", "sign": -1, "idle": "CHECK"}
    assert "# not used: note_std" in text
    with pytest.raises(ConfigError, match=r"channels.supply_a_mean.idle: .*CHECK"):
        make_csv({}).read([log], given, two_joints)
    recording = make_csv({}).read([log], answered(text), two_joints)
    np.testing.assert_allclose(recording.values("supply_a_mean"), 2 + STEPS / 100, rtol=1e-6)
    np.testing.assert_allclose(recording.values("joint_velocity")[:, 1], -STEPS / 20, rtol=1e-6)


def test_a_spreadsheets_dialect_is_noticed(tmp_path, two_joints):
    names, *rows = csv_of(COLUMNS, ";", ",").splitlines()
    (tmp_path / "log.csv").write_text("\n".join(["My robot", names, "ms;N*m;N*m;rad/s;rad/s;A;-", *rows]) + "\n")
    given = answered(suggested_mapping(tmp_path / "log.csv", two_joints))
    assert [given[key] for key in ("preamble", "units_row", "delimiter", "decimal")] == [1, True, ";", ","]
    assert make_csv({}).read([tmp_path / "log.csv"], given, two_joints).num_samples == 60


@pytest.mark.parametrize(
    ("stamps", "unit"),
    [
        (0.02 * STEPS, "s"),
        (20 * STEPS, "ms"),
        (20_000 * STEPS, "us"),
        (20_000_000 * STEPS, "ns"),
        (1.7e9 + 0.02 * STEPS, "s"),
        (1_700_000_000_000 + 20 * STEPS, "ms"),
        (1_700_000_000_000_000_000 + 20_000_000 * STEPS, "ns"),
    ],
)
def test_the_unit_of_stamps_is_told_by_their_size(tmp_path, two_joints, stamps, unit):
    (tmp_path / "log.csv").write_text(csv_of({"t": stamps, "tau_hip": STEPS / 10, "tau_knee": STEPS / 10}))
    assert yaml.safe_load(suggested_mapping(tmp_path / "log.csv", two_joints))["time"] == {"column": "t", "unit": unit}


@pytest.mark.parametrize(
    "steps_ms",
    [np.where(STEPS == 40, 2020, 20), np.where(STEPS % 2 == 0, 2, 38)],
    ids=["a hole of two seconds", "in bursts of two"],
)
def test_the_rate_is_that_between_holes(tmp_path, two_joints, steps_ms):
    log = tmp_path / "log.csv"
    log.write_text(csv_of({**COLUMNS, "timestamp_ms": 1_763_000_000_000 + np.cumsum(steps_ms)}))
    text = suggested_mapping(log, two_joints)
    (told,) = [line for line in text.splitlines() if line.startswith("rate_hz")]
    assert 49 < float(told.split("about ")[1].split(" Hz")[0]) < 51


def test_what_cannot_be_told_is_marked(tmp_path, two_joints):
    """No header line; numbered joints; torques beyond the robot's limits; no time."""
    (tmp_path / "log.csv").write_text(csv_of(COLUMNS).split("\n", 1)[1])
    text = suggested_mapping(tmp_path / "log.csv", two_joints)
    assert "header: false" in text and "CHECK: joint_order" in text and "CHECK: no joint channel was recognised" in text
    assert yaml.safe_load(text)["time"] == {"column": 0, "unit": "ms"}
    numbered = {"stamp": 0.02 * STEPS, "tau_0": 300.0 + STEPS, "tau_1": 300.0 + STEPS}
    (tmp_path / "log.csv").write_text(csv_of(numbered))
    text = suggested_mapping(tmp_path / "log.csv", two_joints)
    assert 'joints: {hip: "0", knee: "1"}  # CHECK: numbered in the log, the robot\'s order is assumed' in text
    assert "CHECK: typical values lie beyond the robot's limits" in text
    (tmp_path / "log.csv").write_text("tau_hip,tau_knee\n" + "".join(f"{i % 5},1\n" for i in range(20)))
    text = suggested_mapping(tmp_path / "log.csv", two_joints)
    assert "time: {column: CHECK, unit: CHECK}  # CHECK: no column of increasing times" in text


@pytest.mark.parametrize(
    ("channel", "pattern", "unit", "size"),
    [
        ("joint_velocity", "vel_{}_rpm", "rpm", 2 * np.pi / 60),
        ("joint_velocity", "vel_RPM_{}", "rpm", 2 * np.pi / 60),
        ("joint_torque", "tau_{}_mNm", "mN*m", 1e-3),
        ("joint_torque", "tau_{}_Nm", "N*m", 1.0),
    ],
)
def test_the_unit_behind_a_joints_name_is_taken(tmp_path, two_joints, channel, pattern, unit, size):
    """Speeds of a robot that stands are within its limits in any unit, so values alone would not tell."""
    log = tmp_path / "log.csv"
    log.write_text(csv_of({"t": 0.02 * STEPS, **{pattern.format(joint): STEPS / 60 for joint in ("hip", "knee")}}))
    text = suggested_mapping(log, two_joints)
    assert yaml.safe_load(text)["channels"][channel]["unit"] == unit
    recording = make_csv({}).read([log], answered(text), two_joints)
    np.testing.assert_allclose(recording.values(channel)[:, 0], size * STEPS / 60, rtol=1e-5, atol=1e-9)


def test_targets_do_not_stand_in_for_what_was_measured(tmp_path, two_joints):
    names = ("target_q", "actual_q", "target_qd", "actual_qd", "target_moment")
    columns = {"t": 20 * STEPS, **{f"{name}_{joint}": STEPS / 100 for name in names for joint in ("hip", "knee")}}
    (tmp_path / "log.csv").write_text(csv_of(columns))
    channels = yaml.safe_load(suggested_mapping(tmp_path / "log.csv", two_joints))["channels"]
    found = {name: one["columns"] for name, one in channels.items()}
    assert found == {
        "joint_position": "actual_q_{joint}",
        "joint_velocity": "actual_qd_{joint}",
        "joint_torque": "target_moment_{joint}",
        "joint_target": "target_q_{joint}",
    }


@pytest.mark.parametrize("between", [".", "-", " ", "_"])
def test_a_log_may_part_the_words_of_joints_otherwise(tmp_path, two_joints, between):
    two_joints.spec = replace(two_joints.spec, joint_names=("LF_hip", "LF_knee"))
    names = [f"LF{between}{part}{between}{what}" for what in ("angle", "rate", "tau") for part in ("hip", "knee")]
    (tmp_path / "log.csv").write_text(csv_of({"t": 20 * STEPS, **dict.fromkeys(names, STEPS / 100)}))
    given = yaml.safe_load(suggested_mapping(tmp_path / "log.csv", two_joints))
    assert given["joints"] == {"LF_hip": f"LF{between}hip", "LF_knee": f"LF{between}knee"}
    found = {name: one["columns"].replace("{joint}" + between, "") for name, one in given["channels"].items()}
    assert found == {"joint_position": "angle", "joint_velocity": "rate", "joint_torque": "tau"}


@pytest.mark.parametrize(
    ("name", "unit"),
    [
        ("I_bat_mA", "mA"),
        ("busVoltage_mV", "mV"),
        ("CURRENT_MA", "mA"),
        ("supplyAmps", "A"),
        ("U_bat", "V"),
        ("P_bat", "W"),
        ("I_main", "A"),
        ("P_gain", None),
        ("u", None),
        ("mAh_used", None),
    ],
)
def test_a_gauge_is_known_by_its_unit_or_its_symbol(tmp_path, two_joints, name, unit):
    log = tmp_path / "log.csv"
    log.write_text(csv_of({"t": 20 * STEPS, "tau_hip": STEPS / 10, "tau_knee": STEPS / 10, name: 5 + STEPS % 7}))
    channels = yaml.safe_load(suggested_mapping(log, two_joints))["channels"]
    assert channels.get(name.lower(), {}).get("unit") == unit


def test_arrays_of_an_npz_and_lists_of_a_parquet_are_understood(tmp_path, two_joints):
    tau = np.stack([STEPS / 10, -STEPS / 10], axis=1)
    np.savez(tmp_path / "log.npz", time=0.02 * STEPS, tau=tau, current=3 + STEPS / 100)
    given = answered(suggested_mapping(tmp_path / "log.npz", two_joints))
    assert (given["reader"], given["channels"]["joint_torque"]["columns"]) == ("npz", "tau[{joint}]")
    import pyarrow as pa
    from pyarrow import parquet

    table = pa.table({"time": 0.02 * STEPS, "tau": tau.tolist(), "current": 3 + STEPS / 100})
    parquet.write_table(table, tmp_path / "log.parquet")
    given = answered(suggested_mapping(tmp_path / "log.parquet", two_joints))
    assert (given["reader"], given["channels"]["joint_torque"]["columns"]) == ("parquet", "tau[{joint}]")
    from hts.recordings.parquet_reader import make

    assert make({}).read([tmp_path / "log.parquet"], given, two_joints).num_samples == 60


def test_a_table_with_spaces_between_columns_is_one(tmp_path, two_joints):
    """As np.savetxt writes it."""
    np.savetxt(tmp_path / "log.txt", np.stack([STEPS / 50, STEPS, STEPS], 1))
    given = yaml.safe_load(suggested_mapping(tmp_path / "log.txt", two_joints))
    assert (given["delimiter"], given["header"], given["time"]) == (" ", False, {"column": 0, "unit": "s"})


@pytest.mark.skipif(importlib.util.find_spec("mcap_ros2") is None, reason="the extra hard-to-sim[ros] is not installed")
def test_the_fullest_topic_of_a_bag_is_taken(tmp_path, two_joints):
    import bags

    given = yaml.safe_load(suggested_mapping(bags.mcap(tmp_path / "a.mcap"), two_joints))
    assert (given["reader"], given["topic"]) == ("ros", "/joint_states")
    assert given["time"] == {"column": "log_time", "unit": "ns"}
    assert given["channels"]["joint_torque"]["columns"] == "effort[{joint}]"
    from hts.recordings.ros_reader import make

    recording = make({}).read([tmp_path / "a.mcap"], given, two_joints)  # the messages have the knee first
    np.testing.assert_allclose(recording.values("joint_torque")[:, 0], np.arange(40) / 10, atol=1e-6)


@pytest.mark.parametrize("content", [b"", bytes(range(256)) * 20, b"hello\n", b"PK\x03\x04xx", b"PAR1 and no more"])
def test_a_file_without_columns_is_one_line(tmp_path, two_joints, content):
    (tmp_path / "log").write_bytes(content)
    with pytest.raises(RecordingError, match="log: ") as refused:
        suggested_mapping(tmp_path / "log", two_joints)
    assert "\n" not in str(refused.value)


def test_a_suggestion_is_yaml_that_the_mapping_loader_takes(tmp_path, two_joints):
    """Names that are no plain YAML are quoted."""
    columns = {"time": 20 * STEPS, "tau hip": STEPS, "tau knee": STEPS, 'volts: "main"': STEPS, "#amps": STEPS}
    (tmp_path / "log.csv").write_text(
        "\n".join(
            ['time,tau hip,tau knee,"volts: ""main""",#amps']
            + [",".join(map(str, row)) for row in zip(*columns.values(), strict=True)]
        )
    )
    (tmp_path / "m.yaml").write_text(suggested_mapping(tmp_path / "log.csv", two_joints))
    given = load_mapping(tmp_path / "m.yaml")
    assert {one["columns"] for one in given["channels"].values()} == {"tau {joint}", 'volts: "main"', "#amps"}


def test_what_an_objective_measures_gets_its_name_and_what_it_lacks_is_listed(tmp_path, two_joints):
    (tmp_path / "log.csv").write_text(csv_of({**COLUMNS, "U_pack_mV": 24_000 + STEPS}))
    power = load().make_objective("power")
    given = yaml.safe_load(suggested_mapping(tmp_path / "log.csv", two_joints, [power]))
    measured = {name: one["unit"] for name, one in given["channels"].items() if "idle" in one}
    assert measured == {"battery_current": "A", "battery_voltage": "mV"}

    (tmp_path / "two.csv").write_text(csv_of({**COLUMNS, "motor_amps": STEPS}))  # which of the two is not known
    text = suggested_mapping(tmp_path / "two.csv", two_joints, [power])
    assert "  supply_a_mean: {" in text and "  motor_amps: {" in text
    lacking = [line for line in text.splitlines() if "needs it" in line]
    assert [line.split("recognised. ")[1] for line in lacking] == [
        "battery_current: {columns: ..., unit: A, idle: CHECK}",
        "battery_voltage: {columns: ..., unit: V, idle: CHECK}",
    ]
    assert set(yaml.safe_load(text)["channels"]) == {"joint_torque", "joint_velocity", "supply_a_mean", "motor_amps"}


def test_a_gauge_of_the_very_name_that_is_asked_for_is_not_doubted(tmp_path, two_joints):
    content = csv_of({**COLUMNS, "Battery Current": STEPS, "motor_amps": STEPS, "U_pack_mV": 24_000 + STEPS})
    (tmp_path / "log.csv").write_text(content)
    text = suggested_mapping(tmp_path / "log.csv", two_joints, [load().make_objective("power")])
    doubts = {line.split(":")[0].strip(): line.split("# CHECK: ")[1] for line in text.splitlines() if "idle:" in line}
    assert doubts["battery_current"] == "idle level and unit"
    assert doubts["motor_amps"] == "idle level, unit, and the channel's name, which an objective asks for"
    assert doubts["battery_voltage"].endswith("whether it is battery_voltage, by its unit alone")


class Warmth(CostObjective):
    """Measures what no unit in a column's name tells."""

    target = Channel("motor_temperature", "degC", ())


class Holding(LogOnlyRobot):
    """Its task is a height."""

    def task(self):
        return Hold()


class Hold(Task):
    quantity, unit, channels, set_points = "height", "m", ("tip_height",), (0.1,)

    def achieved(self, channels):
        return channels["tip_height"]

    def done(self, achieved, set_point, tolerance):
        return achieved > set_point


def test_a_column_of_the_very_name_is_recognised_whatever_its_quantity(tmp_path, two_joints):
    arm = Holding(two_joints.spec, [*two_joints.channels().values(), Channel("tip_height", "m", ())])
    (tmp_path / "log.csv").write_text(csv_of({**COLUMNS, "Motor.Temperature": 30 + STEPS, "tip_height": STEPS / 60}))
    text = suggested_mapping(tmp_path / "log.csv", arm, [Warmth()])
    given = yaml.safe_load(text)["channels"]
    assert given["motor_temperature"] == {"columns": "Motor.Temperature", "unit": "degC", "idle": "CHECK"}
    assert given["tip_height"] == {"columns": "tip_height", "unit": "m"}
    assert "needs it" not in "".join(line for line in text.splitlines() if "motor_temperature" in line)
    assert "commands: [{seconds: CHECK, set_point: CHECK}]" in text
    assert "motor_temperature" not in yaml.safe_load(suggested_mapping(tmp_path / "log.csv", arm))["channels"]


def test_of_two_columns_of_one_name_none_is_taken(tmp_path, two_joints):
    (tmp_path / "log.csv").write_text(csv_of({**COLUMNS, "motor_temperature": STEPS, "Motor.Temperature": STEPS}))
    text = suggested_mapping(tmp_path / "log.csv", two_joints, [Warmth()])
    assert "objective 'cost' needs it, no column was recognised. motor_temperature" in text
