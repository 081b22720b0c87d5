"""Forces under feet that are no newtons are noted, and so are those of other legs."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from hts import plugins
from hts.config import Command, ScheduleConfig
from hts.recordings import Series
from hts.recordings.doubts import doubts
from hts.recordings.feet import alike_at_best, foot_notes, quick
from hts.worlds.base import request_id, seed_sequence
from hts.worlds.twin.parameters import TwinSettings
from hts.worlds.twin.programme import Block, Session
from hts.worlds.twin.session import Batch

LOGS = Path(os.environ.get("HTS_REAL_LOGS", Path(__file__).parents[3] / "shared" / "real-logs")) / "go2_walk"
LEFT_RIGHT = [3, 4, 5, 0, 1, 2, 9, 10, 11, 6, 7, 8]  # FR, FL, RR, RL


@pytest.fixture(scope="module")
def robot():
    return plugins.load().make_robot("go1")


@pytest.fixture(scope="module")
def walk(robot, tmp_path_factory):
    from hts.policies.export import to_onnx
    from hts.policies.files import load_policy

    policy = to_onnx(load_policy(robot.pretrained_policy()), tmp_path_factory.mktemp("policy") / "walk.onnx")
    made = Batch(robot, TwinSettings(), {}, 1, seed_sequence(0, request_id("test")))
    schedule = ScheduleConfig(commands=(Command(seconds=8.0, vx=0.6),))
    return made.run([Session(id="s", blocks=(Block(policy=str(policy), schedule=schedule),))], "twin")[0][0]


def changed(recording, name: str, change):
    values = {
        one: Series(series.channel, change(series.values) if one.startswith(name) else series.values)
        for one, series in recording.channels.items()
    }
    return recording.replace(channels=values)


def test_feet_that_carry_the_robot_are_taken_loads_and_drift_and_all(robot, walk):
    assert foot_notes(walk, robot) == {}
    assert foot_notes(walk.replace(mass_kg=None), robot) == {}
    assert foot_notes(changed(walk, "foot_force", lambda force: 1.6 * force), robot) == {}
    assert foot_notes(changed(walk, "foot_force", lambda force: force - 30), robot) == {}


@pytest.mark.parametrize("factor", [3.5, 1 / 9.81, 0.001], ids=["counts", "kilograms", "kN"])
def test_another_unit_is_noted_and_said_by_the_run(robot, walk, factor):
    log = changed(walk, "foot_force", lambda force: factor * force)
    notes = foot_notes(log, robot)
    assert "times the robot's weight (130 N)" in notes["foot_force_scale"]
    assert len(doubts([log.replace(notes={**log.notes, **notes})])) == 1
    assert foot_notes(log, robot, stated={"foot_force"}) == {}
    assert foot_notes(log.replace(fell=True), robot) == {}


def test_legs_that_are_exchanged_in_all_channels_of_joints_or_in_the_feet_are_noted(robot, walk):
    for log in (
        changed(walk, "joint_", lambda values: values[:, LEFT_RIGHT]),
        changed(walk, "foot_force", lambda force: force[:, [1, 0, 3, 2]]),
    ):
        told = foot_notes(log, robot)["foot_force_legs"]
        assert told.startswith("foot_force falls where joint_torque of the same leg rises")
        assert "FR_foot with the leg of FL_foot, FL_foot with the leg of FR_foot" in told
        assert foot_notes(log, robot, stated={"foot_force"}) == {}


def test_feet_that_are_late_look_like_those_of_other_legs_and_the_note_says_so(robot, walk):
    late = foot_notes(changed(walk, "foot_force", lambda force: np.roll(force, 8, axis=0)), robot)
    assert "is one of the two late by 0.1 s and more?" in late["foot_force_legs"]
    assert foot_notes(changed(walk, "foot_force", lambda force: np.roll(force, 2, axis=0)), robot) == {}


def test_a_zero_that_moved_is_asked_about_above_and_who_carried_it_below(robot, walk):
    zero = foot_notes(changed(walk, "foot_force", lambda force: force + 60), robot)["foot_force_scale"]
    assert "has the zero of the sensors moved?" in zero and "carried" not in zero


@pytest.mark.skipif(not LOGS.is_dir(), reason="real logs are not here; HTS_REAL_LOGS names their folder")
@pytest.mark.parametrize("name", ["walking5", "back_both_wire2"])
def test_the_feet_of_a_public_log_are_those_of_the_other_side(name):
    """Its columns foot_FL and foot_FR, foot_RL and foot_RR are exchanged: the robot's own order is FR, FL, RR, RL."""
    names, *rows = [line.split(",") for line in (LOGS / f"{name}.csv").read_text().splitlines()]
    values = np.array(rows, dtype=np.float64)
    times = np.arange(values[0, 0], values[-1, 0], 0.02)

    def column(wanted: str) -> np.ndarray:
        return np.interp(times, values[:, 0], values[:, names.index(wanted)])

    legs = ("FR", "FL", "RR", "RL")
    force = np.stack([column(f"foot_{leg}") for leg in legs], axis=1)
    torques = [[column(f"{leg}_{part}_tau") for part in ("hip", "thigh", "calf")] for leg in legs]
    effort = np.sqrt((np.array(torques) ** 2).sum(axis=1)).T
    alike = alike_at_best(quick(force, 50), quick(effort, 50), np.ones(len(times), dtype=np.bool_), 3)
    assert np.diag(alike).mean() < -0.6 and alike[[0, 1, 2, 3], [1, 0, 3, 2]].mean() > 0.7
