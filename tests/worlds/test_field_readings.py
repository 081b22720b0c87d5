"""Logs of a visit that agree with themselves, and with their policies only when they are read in another way."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from field_folder import SECONDS, bundle, field, fill_in

from hts.config import Command, ScheduleConfig
from hts.errors import RecordingError, WaitingForRobot
from hts.recordings import Series
from hts.worlds.base import request_id, seed_sequence, walking
from hts.worlds.field_readings import check_readings, readings
from hts.worlds.twin.parameters import TwinSettings
from hts.worlds.twin.programme import Block, Session
from hts.worlds.twin.session import Batch

COMMANDS = (Command(seconds=4.0, vx=0.5), Command(seconds=4.0, vx=0.6, yaw_rate=0.5))
NOISY = {"sensors": {"gravity_noise": 0.02, "gyro_noise": 0.1, "velocity_noise": 0.5, "position_noise": 0.01}}
LEFT_RIGHT = (3, 4, 5, 0, 1, 2, 9, 10, 11, 6, 7, 8)  # FR, FL, RR, RL


def walked(robot, policy: Path, settings):
    made = Batch(robot, TwinSettings(**settings), {}, 1, seed_sequence(0, request_id("test")))
    session = Session(id="s", blocks=(Block(policy=str(policy), schedule=ScheduleConfig(commands=COMMANDS)),))
    return made.run([session], "twin")[0][0]


def changed(recording, channel: str, change):
    """What a log says that writes a channel (or all whose names begin so) in another way."""
    values = {
        name: Series(series.channel, change(series.values) if name.startswith(channel) else series.values)
        for name, series in recording.channels.items()
    }
    return recording.replace(channels=values)


def look(recording, policy: Path) -> None:
    check_readings([Path("00.csv")], [recording], [policy])


@pytest.mark.parametrize("settings", [{}, NOISY], ids=["default", "noisy"])
def test_a_walk_that_is_read_otherwise_is_refused_with_how_to_read_it(robot, policy, settings):
    recording = walked(robot, policy, settings)
    look(recording, policy)
    with pytest.raises(RecordingError) as told:
        look(changed(recording, "joint_", lambda values: values[:, LEFT_RIGHT]), policy)
    assert str(told.value).startswith(
        "00.csv: computed again from the log, the joint targets of walk.onnx are off by 0.1"
    )
    assert (
        "rad with its FL taken as FR, its FR taken as FL, its RL taken as RR, its RR taken as RL in "
        "all channels of joints. Expected less than 0.0"
    ) in str(told.value)
    assert "correct `joints`, `joint_order` or the columns in the mapping" in str(told.value)
    with pytest.raises(RecordingError, match=r"with angular_velocity taken as \(y, x, z\) of what the log calls"):
        look(changed(recording, "angular_velocity", lambda values: values[:, [1, 0, 2]]), policy)
    with pytest.raises(RecordingError, match="with the yaw rate of command taken as deg/s"):
        look(changed(recording, "command", lambda values: values * np.float32([1, 1, 180 / np.pi])), policy)


@pytest.mark.parametrize(
    ("channel", "change"),
    [
        ("angular_velocity", lambda values: np.roll(values, 8, axis=0)),
        ("angular_velocity", lambda values: values * 0),
        ("projected_gravity", lambda values: np.roll(values, 8, axis=0)),
        ("joint_velocity", lambda values: (values + np.roll(values, 1, axis=0) + np.roll(values, 2, axis=0)) / 3),
        ("joint_target", lambda values: (values + np.roll(values, 1, axis=0) + np.roll(values, 2, axis=0)) / 3),
        ("joint_position", lambda values: values + np.float32(0.03)),
        ("command", lambda values: values * np.float32([1, 1, 0])),
    ],
    ids=["late gyroscope", "no gyroscope", "late attitude", "smooth speeds", "smooth targets", "zeros", "no turn"],
)
def test_what_no_other_reading_explains_is_not_refused(robot, policy, channel, change):
    look(changed(walked(robot, policy, {}), channel, change), policy)


def test_nothing_is_said_of_a_fall_nor_of_a_log_without_targets(robot, policy):
    swapped = changed(walked(robot, policy, {}), "joint_", lambda values: values[:, LEFT_RIGHT])
    look(swapped.replace(fell=True), policy)
    look(swapped.replace(channels={k: v for k, v in swapped.channels.items() if k != "joint_target"}), policy)


def test_joints_are_exchanged_by_what_their_names_tell(robot, policy):
    recording = walked(robot, policy, {})
    shown = [one.words for one in readings(recording.replace(joint_names=("hip", "knee", "ankle_a")))]
    assert not [words for words in shown if "channels of joints" in words]
    two = recording.replace(joint_names=("left_hip", "right_hip", "left_knee", "right_knee"))
    shown = [one.words for one in readings(two) if "channels of joints" in one.words]
    assert shown == [
        "its right taken as left, its left taken as right in all channels of joints",
        "its knee taken as hip, its hip taken as knee in all channels of joints",
    ]


def test_a_visit_of_which_all_logs_have_their_legs_exchanged_is_refused(run, robot, policy):
    """No log of the visit agrees with its policy, so none could show that the others do not."""
    from test_field_ran import walk

    asked = walking(0.5, SECONDS)
    with pytest.raises(WaitingForRobot):
        field(run).collect([policy, policy], asked)
    fill_in(run)
    logs = bundle(run) / "logs"
    for name in ("00", "01"):
        walk(logs / f"{name}.csv", robot, policy)
    assert len(field(run).collect([policy, policy], asked)) == 2
    for name in ("00", "01"):
        header, *rows = (logs / f"{name}.csv").read_text().splitlines()
        swap = {"FR_": "FL_", "FL_": "FR_", "RR_": "RL_", "RL_": "RR_"}
        names = ",".join(swap.get(column[:3], column[:3]) + column[3:] for column in header.split(","))
        (logs / f"{name}.csv").write_text("\n".join([names, *rows]) + "\n")
    with pytest.raises(RecordingError, match=r"00\.csv: computed again .* its FL taken as FR"):
        field(run).collect([policy, policy], asked)
