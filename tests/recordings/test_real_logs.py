"""Logs of real robots, recorded by others: suggested mappings, labels, joined clocks, lag. Their import itself is in
test_real_log_import.py. They stay out of the repository."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
import yaml

from hts.channels import Channel
from hts.contracts import LogOnlyRobot, RobotSpec
from hts.errors import RecordingError
from hts.recordings.csv_reader import make
from hts.recordings.lag import gauge_lag
from hts.recordings.suggest import suggested_mapping

LOGS = Path(os.environ.get("HTS_REAL_LOGS", Path(__file__).parents[3] / "shared" / "real-logs"))
pytestmark = pytest.mark.skipif(not LOGS.is_dir(), reason="real logs are not here; HTS_REAL_LOGS names their folder")
LEGS = tuple(f"{leg}_{part}" for leg in ("FL", "FR", "RL", "RR") for part in ("hip", "thigh", "calf"))


def log_only(joints, torque, speed, rate_hz, reach=3.0):
    limits = {
        "torque_limit": torque,
        "velocity_limit": [speed] * len(joints),
        "position_limit": [(-reach, reach)] * len(joints),
    }
    units = {"joint_position": "rad", "joint_velocity": "rad/s", "joint_torque": "N*m"}
    channels = [Channel(name, unit, (len(joints),)) for name, unit in units.items()]
    return LogOnlyRobot(RobotSpec.log_only("real", joints, **limits, rate_hz=rate_hz), channels)


@pytest.fixture
def quadruped():
    return log_only(LEGS, [23.7, 23.7, 45.43] * 4, 30.0, 50)


@pytest.fixture
def arm():
    """A UR3e: limits of its data sheet, 56, 28 and 12 N·m."""
    return log_only([f"j{i}" for i in range(6)], [56.0, 56.0, 28.0, 12.0, 12.0, 12.0], 6.3, 25, reach=6.5)


def test_the_suggestion_for_a_standing_robot_needs_its_idle_level_alone(quadruped):
    log = LOGS / "go2_idle" / "nob_idle_holdout.csv"
    text = suggested_mapping(log, quadruped)
    given = yaml.safe_load(text)
    (gauge,) = [name for name, one in given["channels"].items() if "idle" in one]
    assert given["channels"][gauge]["sign"] == -1 and "CHECK: sign: its values are negative" in text
    given["channels"][gauge]["idle"] = 0.8
    recording = make({}).read([log], given, quadruped)
    assert recording.values(gauge).mean() == pytest.approx(2.03, abs=0.01)
    assert recording.notes["empty_rows_dropped"] == "1"
    assert recording.values("joint_torque")[:, 2].mean() == pytest.approx(3.79, abs=0.05)


def test_the_suggestion_for_its_mislabelled_sibling_marks_what_cannot_be_and_import_refuses_it(quadruped):
    log = LOGS / "go2_idle" / "nob_kick.csv"
    text = suggested_mapping(log, quadruped)
    (torque,) = [line for line in text.splitlines() if "joint_torque" in line]
    assert "CHECK: typical values lie beyond the robot's limits" in torque
    given = yaml.safe_load(text)
    for one in given["channels"].values():
        one |= {"idle": 0.8} if "idle" in one else {}
    with pytest.raises(RecordingError, match="beyond its limit .23.7., and 7 more joints likewise.*as temperatures do"):
        make({}).read([log], given, quadruped)


@pytest.mark.parametrize(
    ("name", "take", "stretches"),
    [
        ("walking5", ("Walking",), [(0.0, 8.0)]),
        ("back_both_wire2", ("Walking",), [(0.25, 3.25)]),
        ("back_both_wire2", ("Walking", "Entangled"), [(0.25, 3.25), (3.25, 5.25)]),
    ],
)
def test_labelled_stretches_of_an_irregular_walk_become_recordings(quadruped, name, take, stretches):
    files = [LOGS / "go2_walk" / f"{name}{ending}.csv" for ending in ("", "_label")]
    given = yaml.safe_load(suggested_mapping(files[0], quadruped))
    given |= {"files": {"log": f"{name}.csv", "labels": "*_label.csv"}}
    given["labels"] = {
        "file": "labels",
        "start": "start_time",
        "end": "end_time",
        "label": "Status",
        "take": list(take),
    }
    for one in given["channels"].values():
        one["file"] = "log"
    recordings = make({}).read_all(files, given, quadruped)
    assert len(recordings) == len(stretches)
    for one, (start, end) in zip(recordings, stretches, strict=True):
        assert one.seconds == pytest.approx(end - start, abs=0.1)
        assert one.notes["labels"].startswith(f"{start:g} to {end:g} s ")
        assert one.rate_hz == 50 and np.allclose(np.diff(one.time), 0.02)


@pytest.mark.parametrize(("kp", "kd"), [(20.0, 0.5), (40.0, 1.0), (60.0, 2.0)])
def test_torques_of_a_walking_robot_are_those_of_its_joint_controllers(tmp_path, quadruped, kp, kd):
    """Its gains are nobody's to know; it stands, walks, and is let go. The other way round its torques are refused."""
    order = [f"{leg}_{part}" for leg in ("FR", "FL", "RR", "RL") for part in ("hip", "thigh", "calf")]
    columns = {
        "joint_position": ("1..12", "rad", "state"),
        "joint_velocity": ("13..24", "rad/s", "state"),
        "joint_torque": ("25..36", "N*m", "state"),
        "joint_target": ("1..12", "rad", "command"),
    }
    given = {
        "header": False,
        "files": {"state": "*state*", "command": "*command*"},
        "time": {"column": 0, "unit": "ns"},
        "rate_hz": 50,
        "joint_order": order,
        "channels": {
            name: {"columns": wanted, "unit": unit, "file": file, "real": False}
            for name, (wanted, unit, file) in columns.items()
        },
        "recording": {"kp": [kp] * 12, "kd": [kd] * 12},
    }
    files = [LOGS / "go2_rl" / f"test_1__{name}_history.csv" for name in ("state", "command")]
    notes = make({}).read(files, given, quadruped).notes
    assert not [key for key in notes if key.startswith("joint_torque")]
    given["channels"]["joint_torque"]["scale"] = 1 / 6.33
    assert "joint_torque_scale" in make({}).read(files, given, quadruped).notes
    given["channels"]["joint_torque"] |= {"scale": 1.0, "sign": -1}
    with pytest.raises(RecordingError, match="'joint_torque' is not what the joint controllers give.*say sign: -1"):
        make({}).read(files, given, quadruped)


def test_two_halves_of_a_real_walk_with_clocks_of_their_own_are_joined(tmp_path, quadruped):
    """Positions in one file, velocities in another that began 1.3 s later, counts from 0 and lost every third row. The
    hip's position is in both."""
    names, *rows = [line.split(",") for line in (LOGS / "go2_walk" / "walking5.csv").read_text().splitlines()]
    values = np.array(rows, dtype=np.float64)
    start = values[0, 0] + 1.3
    q = [names.index(f"{leg}_q") for leg in LEGS]
    dq = [names.index(f"{leg}_dq") for leg in LEGS]
    late = values[values[:, 0] >= start]
    late = late[np.arange(len(late)) % 3 != 0]
    late[:, 0] -= start
    for name, table, columns in (("a.csv", values, q), ("b.csv", late, [*dq, q[3], q[6], q[9]])):
        header = ",".join(["timestamp", *(names[column] for column in columns)])
        kept = table[:, [0, *columns]]
        np.savetxt(tmp_path / name, kept, fmt="%.9f", delimiter=",", header=header, comments="")
    hips = ["FR_hip_q", "RL_hip_q", "RR_hip_q"]
    channels = {
        "joint_position": {"columns": "{joint}_q", "unit": "rad", "file": "a"},
        "joint_velocity": {"columns": "{joint}_dq", "unit": "rad/s", "file": "b"},
        "hips": {"columns": hips, "unit": "rad", "file": "a", "real": False},
        "hips_again": {"columns": hips, "unit": "rad", "file": "b", "real": False},
    }
    given = {
        "files": {"a": "a.csv", "b": "b.csv"},
        "time": {"column": "timestamp", "unit": "s"},
        "rate_hz": 50,
        "joints": {leg: leg for leg in LEGS},
        "channels": channels,
        "join": {"file": "b", "channel": "hips_again", "match": "hips"},
    }
    recording = make({}).read([tmp_path / "a.csv", tmp_path / "b.csv"], given, quadruped)
    moved = float(recording.notes["clocks"].split("moved by ")[1].split(" s")[0])
    first = late[0, 0] + 1.3  # the first row of b was lost, too
    assert moved == pytest.approx(first, abs=0.004)
    np.testing.assert_allclose(recording.values("hips"), recording.values("hips_again"), atol=0.02)


def test_an_arm_is_a_robot_of_six_joints_and_its_supply_hardly_lags(arm):
    """Everything of the six logs that a fit of the whole robot's current reads."""
    currents = [f"actual_current_{i}" for i in range(6)]
    given = {
        "time": {"column": "timestamp", "unit": "s"},
        "rate_hz": 25,
        "joints": {f"j{i}": str(i) for i in range(6)},
        "channels": {
            "joint_velocity": {"columns": "actual_qd_{joint}", "unit": "rad/s"},
            "joint_torque": {"columns": "target_moment_{joint}", "unit": "N*m"},
            "motor_draw": {"columns": currents, "unit": "A", "real": False},
            "all_motors": {
                "columns": [f"actual_current_{i}" for i in range(6)],
                "unit": "A",
                "real": False,
                "sum": True,
            },
            "supply": {"columns": "actual_robot_current", "unit": "A", "idle": 0.3},
            "voltage": {"columns": "actual_robot_voltage", "unit": "V", "idle": 47.9},
        },
    }
    recordings = {path.stem: make({}).read([path], given, arm) for path in sorted((LOGS / "ur3e").glob("*.csv"))}
    assert {name: one.num_samples for name, one in recordings.items()} == {
        "L0L1": 29, "L1L2": 65, "L2L3": 40, "L3L4": 49, "L4L5": 42, "fig9": 888,
    }  # fmt: skip
    long = recordings["fig9"]
    np.testing.assert_allclose(long.values("all_motors"), long.values("motor_draw").sum(1), atol=1e-4)
    assert np.allclose(long.values("voltage"), 48, atol=1.5)
    lag = gauge_lag([long], "supply", ["motor_draw", "joint_velocity"])
    assert lag is not None and lag.seconds <= 0.2 and lag.r2 > 0.5
