"""Logs of real robots, recorded by others, become recordings. They stay out of the repository."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from two_joint_log import LogOnly, read

from hts.channels import Channel
from hts.errors import RecordingError
from hts.recordings import Series
from hts.recordings.logs import check_targets, check_turning

LOGS = Path(os.environ.get("HTS_REAL_LOGS", Path(__file__).parents[3] / "shared" / "real-logs"))
pytestmark = pytest.mark.skipif(not LOGS.is_dir(), reason="real logs are not here; HTS_REAL_LOGS names their folder")


LEGS = tuple(f"{leg}_{part}" for leg in ("FL", "FR", "RL", "RR") for part in ("hip", "thigh", "calf"))
QUADRUPED = LogOnly(LEGS, torque=(23.7, 23.7, 45.43) * 4)


def stand_mapping(joints: Mapping[str, str]) -> dict[str, Any]:
    return {
        "time": {"column": "timestamp_ms", "unit": "ms"},
        "rate_hz": 50,
        "joints": dict(joints),
        "channels": {
            "joint_velocity": {"columns": "dq_{joint}", "unit": "rad/s"},
            "joint_torque": {"columns": "tau_{joint}", "unit": "N*m"},
            "supply": {"columns": "power_a_mean", "unit": "A", "sign": -1, "idle": 0.8},
        },
    }


def test_a_standing_quadruped_is_read_with_discharge_positive() -> None:
    file = LOGS / "go2_idle" / "nob_idle_holdout.csv"
    recording = read(file, stand_mapping({leg: leg.lower() for leg in LEGS}), QUADRUPED)
    assert recording.seconds == pytest.approx(60.0, abs=0.1)
    assert recording.values("supply").mean() == pytest.approx(2.03, abs=0.01)
    # front left calf carries about 3.8 N*m, front right 3.5: the log lists right legs first, the robot left ones
    assert recording.values("joint_torque")[:, 2].mean() == pytest.approx(3.79, abs=0.05)
    assert recording.notes["empty_rows_dropped"] == "1"


def test_a_log_whose_torques_are_temperatures_is_refused_with_the_reason() -> None:
    with pytest.raises(RecordingError) as refused:
        read(LOGS / "go2_idle" / "nob_kick.csv", stand_mapping({leg: leg.lower() for leg in LEGS}), QUADRUPED)
    message = str(refused.value)
    assert "nob_kick.csv: the columns are not what the mapping says" in message
    assert "'joint_torque' of RL_hip runs from 53 to 53 N*m, beyond its limit (23.7), and 7 more joints" in message
    assert "as temperatures do" in message
    assert "'supply' is -58 A all the time" in message


def test_a_log_with_no_header_and_targets_in_another_file_is_read() -> None:
    log_order = [f"{leg}_{part}" for leg in ("FR", "FL", "RR", "RL") for part in ("hip", "thigh", "calf")]
    mapping = {
        "header": False,
        "files": {"state": "*state*", "command": "*command*"},
        "time": {"column": 0, "unit": "ns"},
        "rate_hz": 50,
        "joint_order": log_order,
        "channels": {
            "joint_position": {"columns": "1..12", "unit": "rad", "file": "state"},
            "joint_velocity": {"columns": "13..24", "unit": "rad/s", "file": "state", "resample": "mean"},
            "joint_torque": {"columns": "25..36", "unit": "N*m", "file": "state"},
            "joint_target": {"columns": "1..12", "unit": "rad", "file": "command"},
        },
    }
    files = [LOGS / "go2_rl" / f"test_1__{name}_history.csv" for name in ("state", "command")]
    recording = read(files, mapping, QUADRUPED)
    assert recording.seconds == pytest.approx(15.1, abs=0.1)
    assert "repeated_while_moving" not in recording.notes  # it is let go at its end, with targets that stay
    position = recording.values("joint_position")
    assert position[0, 3] == pytest.approx(0.0217, abs=1e-3)  # FR_hip, first in the log, fourth in the robot
    # velocity is nearly the derivative of position: same joint, same time, same unit
    slope = np.gradient(position, 0.02, axis=0)
    for joint in range(12):
        assert np.corrcoef(slope[5:-5, joint], recording.values("joint_velocity")[5:-5, joint])[0, 1] > 0.85


def test_an_irregular_walking_log_is_read() -> None:
    mapping = {
        "time": {"column": "timestamp", "unit": "s"},
        "rate_hz": 50,
        "joints": {leg: leg for leg in LEGS},
        "channels": {
            "joint_position": {"columns": "{joint}_q", "unit": "rad"},
            "joint_velocity": {"columns": "{joint}_dq", "unit": "rad/s"},
            "joint_torque": {"columns": "{joint}_tau", "unit": "N*m"},
        },
    }
    for name, seconds in (("walking5.csv", 8.7), ("back_both_wire2.csv", 5.5)):
        recording = read(LOGS / "go2_walk" / name, mapping, QUADRUPED)
        assert recording.seconds == pytest.approx(seconds, abs=0.1)
        assert "repeated_while_moving" not in recording.notes


def test_every_log_of_an_arm_is_read_although_their_line_ends_differ() -> None:
    arm = LogOnly(tuple(f"j{i}" for i in range(6)), torque=(56.0, 56.0, 28.0, 12.0, 12.0, 12.0), speed=6.3)
    mapping = {
        "time": {"column": "timestamp", "unit": "s"},
        "rate_hz": 25,
        "joints": {f"j{i}": str(i) for i in range(6)},
        "channels": {
            "joint_velocity": {"columns": "actual_qd_{joint}", "unit": "rad/s"},
            "joint_torque": {"columns": "target_moment_{joint}", "unit": "N*m"},
            "motor_draw": {"columns": [f"actual_current_{i}" for i in range(6)], "unit": "A", "real": False},
            "supply": {"columns": "actual_robot_current", "unit": "A", "idle": 0.3},
        },
    }
    recordings = {path.stem: read(path, mapping, arm) for path in sorted((LOGS / "ur3e").glob("*.csv"))}
    lengths = {name: recording.num_samples for name, recording in recordings.items()}
    assert not any("repeated_while_moving" in recording.notes for recording in recordings.values())
    assert lengths == {"L0L1": 29, "L1L2": 65, "L2L3": 40, "L3L4": 49, "L4L5": 42, "fig9": 888}


def test_targets_of_a_walk_are_taken_and_offsets_actions_degrees_and_other_signs_are_not() -> None:
    """The robot is let go at the end, so 6 s of its targets stay; of the moving ones few do."""
    mapping = {
        "header": False,
        "files": {"state": "*state*", "command": "*command*"},
        "time": {"column": 0, "unit": "ns"},
        "rate_hz": 50,
        "joint_order": [f"{leg}_{part}" for leg in ("FR", "FL", "RR", "RL") for part in ("hip", "thigh", "calf")],
        "channels": {
            "joint_position": {"columns": "1..12", "unit": "rad", "file": "state"},
            "joint_target": {"columns": "1..12", "unit": "rad", "file": "command"},
        },
    }
    files = [LOGS / "go2_rl" / f"test_1__{name}_history.csv" for name in ("state", "command")]
    walk = read(files, mapping, QUADRUPED)
    pose = np.array([0.0, 0.8, -1.5] * 4)  # rad, as such policies stand
    spec = dataclasses.replace(QUADRUPED.spec, default_pose=tuple(pose))  # its action scale is 0.25 rad
    targets = walk.values("joint_target")
    check_targets(walk, spec, "walk")
    for wrong, told in (
        (targets - pose, "offsets from the default pose"),
        ((targets - pose) / 0.25, "or actions"),
        (np.degrees(targets), "taken as degrees"),
        (-targets, "say sign: -1"),
    ):
        changed = Series(walk.channels["joint_target"].channel, wrong)
        with pytest.raises(RecordingError, match=told):
            check_targets(walk.replace(channels={**walk.channels, "joint_target": changed}), spec, "walk")


@pytest.mark.parametrize("name", ["walking5", "back_both_wire2"])
def test_a_gyroscope_may_be_late_and_not_in_degrees_or_counted_the_other_way(name: str) -> None:
    log = np.genfromtxt(LOGS / "go2_walk" / f"{name}.csv", delimiter=",", names=True)
    log = log[np.isfinite(log["roll"]) & np.isfinite(log["gyro_x"])]
    times = np.arange(log["timestamp"][0] + 0.5, log["timestamp"][-1], 1 / 50)

    def look(factors: tuple[float, ...], late: float = 0.0) -> None:
        """factors: of the gyroscope's axes; late: s by which the attitude is."""
        roll, pitch = (np.interp(times - late, log["timestamp"], log[angle]) for angle in ("roll", "pitch"))
        gravity = np.stack([np.sin(pitch), -np.cos(pitch) * np.sin(roll), -np.cos(pitch) * np.cos(roll)], axis=1)
        gyro = np.stack([np.interp(times, log["timestamp"], log[f"gyro_{axis}"]) for axis in "xyz"], axis=1)
        told = {"projected_gravity": (gravity, "1"), "angular_velocity": (gyro * factors, "rad/s")}
        channels = {kind: Series(Channel(kind, unit, (3,)), values) for kind, (values, unit) in told.items()}
        check_turning(channels, 50.0, name)

    for late in (0.0, 0.1, 0.2, 0.3):
        look((1.0, 1.0, 1.0), late)
    for factors, told in (
        ((57.3, 57.3, 57.3), "in another unit"),
        ((-1.0, -1.0, -1.0), "it is counted the other way"),
        ((1.0, -1.0, -1.0), "one is counted the other way"),
    ):
        with pytest.raises(RecordingError, match=told):
            look(factors)
