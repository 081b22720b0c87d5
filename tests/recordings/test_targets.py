"""Joint targets that are degrees, offsets, actions or those of other joints are refused with what to do."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from two_joint_log import LogOnly

from hts.errors import RecordingError
from hts.recordings.logs import recording_from_columns

LEG = LogOnly(("hip", "thigh", "calf"), torque=20.0)
LEG.spec = dataclasses.replace(LEG.spec, default_pose=(0.0, 1.0, -2.0))
POSE = np.array(LEG.spec.default_pose)
TIMES = np.arange(10 * 50) / 50
SWING = 0.2 * np.sin(2 * np.pi * 2.0 * TIMES[:, None] + np.array([0.0, 1.0, 2.0]))
SAG = np.array([0.0, 0.1, 0.2])
"""rad by which the leg's weight keeps a joint from its target."""


def imported(targets: np.ndarray, swing: np.ndarray = SWING, robot: LogOnly = LEG, **settings: object):
    """A log of a leg that swings about its pose at 2 Hz, told `targets`. settings: of the mapping of these."""
    position = np.array(robot.spec.default_pose) + swing - SAG
    columns = {"t": 20.0 * np.arange(len(TIMES))}
    for joint, at in zip(LEG.spec.joint_names, range(3), strict=True):
        columns |= {f"{joint}_q": position[:, at], f"{joint}_goal": targets[:, at]}
    mapping = {
        "time": {"column": "t", "unit": "ms"},
        "rate_hz": 50,
        "channels": {
            "joint_position": {"columns": "{joint}_q", "unit": "rad"},
            "joint_target": {"columns": "{joint}_goal", "unit": "rad", **settings},
        },
    }
    return recording_from_columns([Path("01.csv")], mapping, robot, lambda path: columns)


TARGETS = POSE + 1.5 * SWING


def test_targets_that_the_joints_follow_are_taken():
    assert np.allclose(imported(TARGETS).values("joint_target"), TARGETS, atol=1e-6)
    imported(np.degrees(TARGETS), unit="deg")


def test_offsets_from_the_default_pose_are_refused_with_how_far_they_lie_off():
    """Of 0, 1 - 0.1 and -2 - 0.2 rad the root mean square is 1.37; read as offsets 0, 0.1 and 0.2 are left: 0.13."""
    with pytest.raises(RecordingError) as told:
        imported(TARGETS - POSE)
    assert str(told.value) == (
        "01.csv: 'joint_target' lies 1.4 rad from 'joint_position' (median of 10 s of moving, root mean square of all "
        "joints), but 0.13 rad taken as what a policy gives, offsets from the default pose or actions. Expected the "
        "angle that is sent, default_pose + offset or default_pose + action_scale * action: write that into the log, "
        "or import without it, --drop joint_target; if it is right, say so with `limits`."
    )


@pytest.mark.parametrize(
    ("logged", "told"),
    [
        (np.degrees(TARGETS), "taken as degrees. Expected rad: say unit: deg"),
        (-TARGETS, "taken the other way. .* say sign: -1"),
        (TARGETS[:, [2, 0, 1]], "in another order of the joints. .* correct the columns"),
        ((TARGETS - POSE + np.array([0.3, -0.3, 0.6])) / 0.25, "taken as what a policy gives, .* or actions"),
    ],
)
def test_other_readings_are_told_apart(logged, told):
    with pytest.raises(RecordingError, match=told):
        imported(logged)


def test_a_person_may_say_that_such_targets_are_right():
    imported(TARGETS - POSE, limits=[-10, 10])


def test_nothing_is_said_where_nothing_explains_it_nothing_moves_or_targets_stay():
    imported(TARGETS + np.array([1.0, 0.0, 0.0]))  # it leans on something
    imported(TARGETS - POSE, swing=0.001 * SWING)
    imported(np.zeros_like(TARGETS))  # torques are sent, and targets written by nobody


def test_a_soft_robot_that_its_weight_keeps_far_from_its_targets_is_read_as_it_is():
    """0.6 rad from targets that as degrees, or scaled as actions, would lie at its pose of zeros."""
    imported(0.6 + 1.5 * SWING, robot=LogOnly(("hip", "thigh", "calf"), torque=20.0))
