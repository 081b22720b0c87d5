"""Joint targets that are degrees, offsets, actions or those of other joints are refused with what to do."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from two_joint_log import LogOnly
from walker_recording import a_recording

from hts.channels import Channel
from hts.errors import RecordingError
from hts.recordings import Recording, Series
from hts.recordings.logs import check_targets, recording_from_columns

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
        "01.csv: 'joint_target' lies 1.4 rad from 'joint_position' (median of 10 s of moving, root mean square of 3 "
        "joints), but 0.13 rad taken as what a policy gives, offsets from the default pose or actions. Expected the "
        "angle that is sent, default_pose + offset or default_pose + action_scale * action: write that into the log, "
        "or leave joint_target out of the mapping (hts import: --drop joint_target); if it is right, "
        "say so with `limits`."
    )


@pytest.mark.parametrize(
    ("logged", "told"),
    [
        (np.degrees(TARGETS), "taken as degrees. Expected rad: say unit: deg"),
        (-TARGETS, "taken the other way. .* say sign: -1"),
        (TARGETS[:, [2, 0, 1]], "in another order of the joints. .* correct the columns"),
        ((TARGETS - POSE + np.array([0.3, -0.3, 0.5])) / 0.25, "taken as what a policy gives, .* or actions"),
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


# ------------------------------------------------------------------------------ machines whose targets lie far rightly

ARM = LogOnly(tuple(f"j{at}" for at in range(6)), torque=200.0)
READY = np.array([0.0, 0.8, -0.9, 0.0, 0.6, 0.0])
"""rad: an arm's default pose, about which it works."""
REACH = np.array([1.4, 0.3, -0.3, 0.3, 0.0, -0.2])


def logged(targets: np.ndarray, positions: np.ndarray) -> Recording:
    """(T, J) each, rad, at 50 Hz."""
    values = {"joint_target": targets, "joint_position": positions}
    channels = {name: Series(Channel(name, "rad", one.shape[1:]), one) for name, one in values.items()}
    return a_recording().replace(channels=channels, rate_hz=50.0)


def carrying() -> tuple[np.ndarray, np.ndarray]:
    """Targets and positions of an arm that carries from READY - REACH to READY + REACH with 1 rad/s, and comes back
    with 2.5: so its goal lies at +REACH most of the time, and its position in the middle."""
    to_and_fro = np.concatenate([np.linspace(-1, 1, 140), np.ones(25), np.linspace(1, -1, 56), -np.ones(25)])
    goal = np.concatenate([np.ones(140), -np.ones(81), np.ones(25)])
    goal, place = (np.tile(one, 8)[:, None] * REACH for one in (goal, to_and_fro))
    return READY + goal, READY + place


@pytest.mark.parametrize("scale", [0.05, 0.1, 0.25])
@pytest.mark.parametrize("jitter", [0.0, 1e-3])
def test_goals_of_an_arm_that_works_about_its_default_pose_are_no_actions(scale, jitter):
    """default_pose + a little of anything lies near it. jitter: rad, of goals that an eye finds anew in each sample."""
    targets, positions = carrying()
    targets = targets + jitter * np.random.default_rng(4).standard_normal(targets.shape)
    spec = dataclasses.replace(ARM.spec, default_pose=tuple(READY), action_scale=(scale,) * 6)
    check_targets(logged(targets, positions), spec, "arm.csv")


def test_goals_that_stay_until_the_next_are_not_read_otherwise():
    """Read the other way these lie on the positions in the median; each joint's goal stays for 3 to 5 s."""
    targets, positions = carrying()
    spec = dataclasses.replace(ARM.spec, default_pose=tuple(READY))
    check_targets(logged(READY - targets, positions - READY - 0.9 * REACH), spec, "arm.csv")


def test_targets_against_the_positions_are_not_the_other_way_if_the_joints_go_where_they_say():
    """An arm that a load keeps down goes the targets' way, from another place."""
    imported(-POSE + 1.5 * SWING)
    with pytest.raises(RecordingError, match="say sign: -1"):
        imported(-POSE - 1.5 * SWING)


def test_another_order_explains_only_what_lies_near_then():
    """Joints that turn on and on, of whatever limits: 90 rad become 10 in another order, which explains nothing."""
    robot = LogOnly(tuple(f"j{at}" for at in range(4)), torque=20.0)
    positions = 8.0 * TIMES[:, None] * np.array([1.0, -1.0, 1.0, -1.0])
    targets = np.sin(TIMES)[:, None] - 50.0 * np.array([1.0, -1.0, 1.0, -1.0])
    check_targets(logged(targets, positions), robot.spec, "rover.csv")


def test_wheels_are_left_out_and_legs_beside_them_are_not():
    """A wheel turns for ever, and is told how fast: 8 rad/s lie anywhere if they are taken as rad."""
    four = LogOnly((*LEG.spec.joint_names, "wheel"), torque=20.0)
    spec = dataclasses.replace(
        four.spec, default_pose=(*POSE, 0.0), position_limit=(*LEG.spec.position_limit, (-1e4, 1e4))
    )
    turns = np.column_stack([POSE + SWING - SAG, 8.0 * TIMES])
    check_targets(logged(np.column_stack([TARGETS, np.full_like(TIMES, 8.0)]), turns), spec, "legs.csv")
    with pytest.raises(RecordingError, match="of 3 joints.*offsets from the default pose"):
        check_targets(logged(np.column_stack([TARGETS - POSE, 8.0 + np.sin(TIMES)]), turns), spec, "legs.csv")
    wheels = dataclasses.replace(spec, position_limit=((-1e4, 1e4),) * 4)
    check_targets(logged(np.column_stack([TARGETS - POSE, 8.0 + np.sin(TIMES)]), turns), wheels, "wheels.csv")


def test_missing_values_are_another_check_s_to_tell():
    one = logged(TARGETS - POSE, POSE + SWING - SAG)
    with pytest.raises(RecordingError, match="offsets from the default pose"):
        check_targets(one, LEG.spec, "01.csv")
    one.channels["joint_target"].values[5, 1] = np.nan
    check_targets(one, LEG.spec, "01.csv")
