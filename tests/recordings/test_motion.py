"""Velocities that are not those of the positions: swapped, in another order, sign or unit."""

from __future__ import annotations

import numpy as np
import pytest
from two_joint_log import LogOnly

from hts.channels import Channel
from hts.contracts import LogOnlyRobot
from hts.errors import ConfigError, RecordingError
from hts.recordings import Series
from hts.recordings.logs import check_motion, recording_from_columns

TIMES = np.arange(300) / 50


def moving(**changes):
    """Hip and knee swing at 0.5 and 0.8 Hz: position, rad, and its derivative, with noise."""
    rates = 2 * np.pi * np.array([0.5, 0.8])
    noise = np.random.default_rng(0).normal(0, 0.2, (300, 2))
    found = {"joint_position": 0.5 * np.sin(TIMES[:, None] * rates)}
    found["joint_velocity"] = 0.5 * rates * np.cos(TIMES[:, None] * rates) + noise
    found |= {name: change(found) for name, change in changes.items()}
    units = {"joint_position": "rad", "joint_velocity": "rad/s"}
    return {name: Series(Channel(name, units[name], (2,)), values) for name, values in found.items()}


def test_velocities_that_are_the_slope_pass(two_joints):
    check_motion(moving(), two_joints.spec, 50.0, "log")


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (lambda v: -v["joint_velocity"], "counted the other way: say sign: -1"),
        (lambda v: v["joint_velocity"] * 57.3, "times the slope of the positions: one of them is in another unit"),
        (
            lambda v: v["joint_velocity"][:, ::-1],
            "the position of hip moves as the velocity of knee says .*different joint orders",
        ),
        (lambda v: v["joint_position"] * 9, "the columns are probably others than the mapping says"),
    ],
)
def test_others_are_refused_with_what_they_look_like(two_joints, change, expected):
    channels = moving(joint_velocity=change)
    with pytest.raises(
        RecordingError, match=f"log: 'joint_velocity' is not how fast 'joint_position' changes.*{expected}"
    ):
        check_motion(channels, two_joints.spec, 50.0, "log")
    check_motion(channels, two_joints.spec, 50.0, "log", stated=["joint_velocity"])


def test_what_stands_still_or_is_short_tells_nothing(two_joints):
    still = moving(joint_position=lambda v: 0 * v["joint_position"])
    check_motion(still, two_joints.spec, 50.0, "log")
    short = {name: Series(one.channel, -one.values[:20]) for name, one in moving().items()}
    check_motion({**short, "joint_position": moving()["joint_position"]}, two_joints.spec, 50.0, "log")


def test_columns_swapped_in_a_log_are_noticed(tmp_path, two_joints, mapping):
    values = {name: one.values for name, one in moving().items()}
    columns = {"t": 1000 * TIMES}
    columns |= {f"{j}_q": values["joint_position"][:, at] for at, j in enumerate("HK")}
    columns |= {f"{j}_dq": values["joint_velocity"][:, at] for at, j in enumerate("HK")}
    mapping["channels"] = {
        "joint_position": {"columns": "{joint}_dq", "unit": "rad"},
        "joint_velocity": {"columns": "{joint}_q", "unit": "rad/s"},
    }
    with pytest.raises(RecordingError, match="log: 'joint_velocity' is not how fast"):
        recording_from_columns([tmp_path / "log"], mapping, two_joints, lambda path: columns)


@pytest.mark.parametrize("turned", [lambda speed: speed * 0.1047, lambda speed: -speed * 0.1047])
def test_a_slow_joint_in_another_unit_is_told_although_it_then_hardly_moves(two_joints, turned):
    slow = {"joint_position": 0.3 * np.sin(TIMES[:, None] * [1.0, 1.5]), "joint_velocity": None}
    slow["joint_velocity"] = turned(np.gradient(slow["joint_position"], 0.02, axis=0))  # turns a minute for rad/s
    changed = moving(**{name: lambda v, one=values: one for name, values in slow.items()})
    with pytest.raises(RecordingError, match=r"it is 0.105 times the slope of the positions, so one of them"):
        check_motion(changed, two_joints.spec, 50.0, "log")
    check_motion(changed, two_joints.spec, 50.0, "log", stated=["joint_velocity"])


def test_noise_beside_a_joint_that_moves_is_not_another_unit(two_joints):
    noise = np.random.default_rng(0).normal(0, 0.05, (300, 2))
    changed = moving(joint_velocity=lambda v: noise)
    check_motion(changed, two_joints.spec, 50.0, "log")


def in_degrees(robot, tmp_path, mapping, turn=1.0):
    """A log whose angles are in degrees, of a machine that has a channel of torques alone. turn: angles times this."""
    only = LogOnlyRobot(robot.spec, [Channel("joint_torque", "N*m", (2,))])
    found = {name: np.degrees(one.values) for name, one in moving().items()}
    columns = {"t": 1000 * TIMES}
    for at, joint in enumerate("HK"):
        columns[f"{joint}_q"] = turn * found["joint_position"][:, at]
        columns[f"{joint}_dq"] = found["joint_velocity"][:, at]
        columns[f"{joint}_tau"] = np.sin(TIMES)
    mapping["channels"] = {
        "joint_torque": {"columns": "{joint}_tau", "unit": "N*m"},
        "joint_position": {"columns": "{joint}_q", "unit": "deg", "real": False},
        "joint_velocity": {"columns": "{joint}_dq", "unit": "deg/s", "real": False},
    }
    return recording_from_columns([tmp_path / "log"], mapping, only, lambda path: columns)


def test_degrees_that_are_called_degrees_are_held_against_limits_in_rad(tmp_path, two_joints, mapping):
    recording = in_degrees(two_joints, tmp_path, mapping)
    assert recording.channels["joint_position"].channel.unit == "deg"  # as the mapping says; only judged in rad
    assert np.abs(recording.channels["joint_position"].values).max() > 20
    with pytest.raises(RecordingError, match=r"'joint_position' of .* rad, beyond its range \(-3 to 3\)"):
        in_degrees(two_joints, tmp_path, mapping, turn=57.3)
    with pytest.raises(RecordingError, match="times the slope of the positions"):
        in_degrees(two_joints, tmp_path, mapping, turn=0.1)


@pytest.mark.parametrize("which", ["joint_position", "joint_velocity"])
def test_a_single_joint_that_is_counted_the_other_way_is_told_with_the_line_to_write(two_joints, which):
    with pytest.raises(RecordingError, match=r"of knee alone one of them .* other way: say sign: \{knee: -1\}"):
        check_motion(moving(**{which: lambda v: v[which] * [1, -1]}), two_joints.spec, 50.0, "log")


def of_single_joints(robot, tmp_path, mapping, position=None, turns=lambda angles: angles, **changes):
    """A log whose knee counts its speed the other way and on the motor's side of a gear of 9. turns: what its encoder
    makes of the knee's angles, rad; position: what the mapping says of it."""
    values = {name: one.values for name, one in moving().items()}
    columns = {"t": 1000 * TIMES, "H_tau": np.sin(TIMES), "K_tau": np.cos(TIMES)}
    for at, (joint, factor) in enumerate((("H", 1), ("K", -9))):
        angles = values["joint_position"][:, at]
        columns |= {f"{joint}_q": turns(angles) if joint == "K" else angles}
        columns |= {f"{joint}_dq": factor * values["joint_velocity"][:, at]}
    mapping["channels"] = {
        "joint_torque": {"columns": "{joint}_tau", "unit": "N*m"},
        "joint_position": {"columns": "{joint}_q", "unit": "rad", **(position or {})},
        "joint_velocity": {"columns": "{joint}_dq", "unit": "rad/s", **changes},
    }
    recording = recording_from_columns([tmp_path / "log"], mapping, robot, lambda path: columns)
    asked = "joint_velocity" if position is None else "joint_position"
    return recording.channels[asked].values, values[asked]


def test_sign_and_scale_may_be_those_of_single_joints(tmp_path, two_joints, mapping):
    found, expected = of_single_joints(two_joints, tmp_path, mapping, sign={"knee": -1}, scale={"knee": 1 / 9})
    np.testing.assert_allclose(found, expected, rtol=1e-5)
    found, expected = of_single_joints(two_joints, tmp_path, mapping, sign=1, scale={"knee": -1 / 9, "hip": 1.0})
    np.testing.assert_allclose(found, expected, rtol=1e-5)


def test_so_may_an_offset_which_comes_after_all_factors(tmp_path, two_joints, mapping):
    """An encoder in half radians, of the other sign, whose zero is 0.12 rad off."""
    said = {"scale": 0.5, "sign": {"knee": -1}, "offset": {"knee": 0.12}}
    found, expected = of_single_joints(
        two_joints,
        tmp_path,
        mapping,
        said,
        lambda angles: -2 * (angles - 0.12),
        sign={"knee": -1},
        scale={"knee": 1 / 9},
    )
    np.testing.assert_allclose(found[:, 1], expected[:, 1], atol=1e-5)
    np.testing.assert_allclose(found[:, 0], expected[:, 0] / 2, atol=1e-5)  # no offset, and the common factor


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"offset": {"nee": 1.0}}, r"channels\.joint_velocity\.offset: No joint of the robot named 'nee'"),
        (
            {"sign": {"nee": -1}},
            r"channels\.joint_velocity\.sign: No joint of the robot named 'nee'. Did you mean 'knee'",
        ),
        ({"sign": {"knee": 2}}, r"channels\.joint_velocity\.sign\.knee: expected 1 or -1, found 2"),
        ({"sign": {"knee": -1}, "per_joint": False}, r"'joint_velocity' has no column for each joint\. Say one number"),
    ],
)
def test_a_sign_or_an_offset_of_a_joint_that_is_none_is_refused(tmp_path, two_joints, mapping, changes, expected):
    if changes.get("per_joint") is False:
        changes = {**changes, "columns": ["H_dq", "K_dq"]}
    with pytest.raises(ConfigError, match=expected):
        of_single_joints(two_joints, tmp_path, mapping, **changes)


# ------------------------------------------------------------------------------------------------ legs that trot

LEGS = ("FL", "FR", "RL", "RR")
TROT = LogOnly(LEGS, torque=20.0)
SWAPPED = [1, 0, 3, 2]


def trot(order=(0, 1, 2, 3), sign=1, noise=0.15, alone=0.6):
    """Diagonal legs together, those of one side against each other, each with a motion of its own beside.

    order: which leg's velocity stands in each column; alone: size of what a leg does by itself, of the common 1.
    """
    chance = np.random.default_rng(1)
    phase = 2 * np.pi * 2.0 * TIMES
    speed = np.stack([np.cos(phase) * side for side in (1, -1, -1, 1)], 1)
    speed = speed + alone * np.stack([np.cos(phase * rate) for rate in (0.55, 0.7, 0.85, 1.3)], 1)
    position = np.cumsum(speed, 0) / 50
    velocity = sign * (speed + chance.normal(0, noise, speed.shape))[:, list(order)]
    shape = (4,)
    return {
        "joint_position": Series(Channel("joint_position", "rad", shape), position),
        "joint_velocity": Series(Channel("joint_velocity", "rad/s", shape), velocity),
    }


def refusal(channels):
    with pytest.raises(RecordingError, match="log: 'joint_velocity' is not how fast") as refused:
        check_motion(channels, TROT.spec, 50.0, "log")
    return str(refused.value)


def test_left_and_right_swapped_in_a_trot_is_an_order_and_no_sign():
    """Each leg moves against the one whose column it has got, as if it were counted the other way."""
    check_motion(trot(), TROT.spec, 50.0, "log")
    said = refusal(trot(SWAPPED))
    assert "(correlation -0.7" in said and "sign" not in said
    assert "the position of FL moves as the velocity of FR says (0.9" in said and "different joint orders" in said


def test_what_a_wrong_sign_would_hide_is_still_found():
    """The same log after somebody wrote sign: -1: its correlation is +0.7, but the columns are in the wrong order."""
    said = refusal(trot(SWAPPED, sign=-1))
    assert "the position of FL moves as the velocity of FR says (-0.9" in said and "different joint orders" in said


def test_two_columns_swapped_among_many_are_found():
    assert "the position of FL moves as the velocity of FR says" in refusal(trot([1, 0, 2, 3]))


def test_a_trot_that_is_counted_the_other_way_is_told_its_sign():
    said = refusal(trot(sign=-1))
    assert "say sign: -1. Correct the mapping" in said and "order" not in said


def test_legs_that_do_nothing_by_themselves_leave_order_and_sign_open():
    said = refusal(trot(SWAPPED, alone=0.0))
    assert "say sign: -1; or columns of left and right are swapped, which fits as well" in said


def test_a_sign_is_advised_only_where_nothing_else_is_wrong_with_the_velocities():
    said = refusal(trot(sign=-1, noise=0.8))
    assert "(correlation -0.7" in said and "look at the order of the columns first" in said and "sign: -1" not in said
