"""`projected_gravity` that is no unit vector is refused where recordings come in: falls would not be seen."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from two_joint_log import TWO_JOINTS
from walker_recording import a_recording

from hts.channels import Channel
from hts.errors import RecordingError
from hts.evaluation.segments import falls_of
from hts.recordings import Series
from hts.recordings.checks import check
from hts.recordings.gravity import check_gravity
from hts.recordings.logs import check_upright, recording_from_columns

UPRIGHT = np.tile([0.0, 0.0, -1.0], (500, 1))


def lying(share: float = 0.5) -> np.ndarray:
    """Upright, then on its side."""
    values = UPRIGHT.copy()
    values[round(len(values) * (1 - share)) :] = [0.0, 0.995, -0.1]
    return values


def imported(values: np.ndarray):
    columns = {"t": 20.0 * np.arange(len(values)), "x": values[:, 0], "y": values[:, 1], "z": values[:, 2]}
    mapping = {
        "time": {"column": "t", "unit": "ms"},
        "rate_hz": 50,
        "channels": {"projected_gravity": {"columns": ["x", "y", "z"], "unit": "1", "real": False}},
    }
    return recording_from_columns([Path("01.csv")], mapping, TWO_JOINTS, lambda path: columns)


def test_metres_per_second_squared_are_refused_with_what_to_write():
    with pytest.raises(RecordingError) as told:
        imported(9.81 * lying())
    assert str(told.value) == (
        "01.csv: 'projected_gravity' is 9.81 long (median of 500 samples). Expected a unit vector, (0, 0, -1) of an "
        "upright robot, by which falls are told; it looks like m/s^2: say scale: 0.102 of it in the mapping."
    )


def test_a_robot_that_lies_on_its_side_has_fallen():
    assert falls_of("", [imported(lying()).replace(role="")]) == 1


@pytest.mark.parametrize(
    ("factor", "told"),
    [
        (-9.81, "say scale: 0.102 of it in the mapping, and sign: -1 if it is an accelerometer's"),
        (1.2, "1.2 long .* or say scale: 0.833 of it in the mapping if it is in another unit"),
        (0.8, "0.8 long .* or say scale: 1.25 "),
        (0.0, "0 long .* these are no attitude: correct its columns"),
    ],
)
def test_other_lengths_are_refused_too(factor, told):
    with pytest.raises(RecordingError, match=told):
        imported(factor * UPRIGHT)


def test_noise_like_that_of_an_accelerometer_is_taken():
    rng = np.random.default_rng(5)
    noisy = UPRIGHT + 0.1 * rng.standard_normal(UPRIGHT.shape)
    noisy[::50] *= 4.0  # impacts
    imported(noisy)


def test_a_recording_of_any_world_is_held_against_it_before_it_is_stored():
    series = Series(Channel("projected_gravity", "1", (3,), may_be_constant=True), 9.81 * UPRIGHT[:50])
    good = a_recording()
    check(good)
    with pytest.raises(RecordingError, match="9.81 long"):
        check(good.replace(channels={**good.channels, "projected_gravity": series}))


# ------------------------------------------------------------------------------------------ which way it points

WALK = np.arange(10 * 50) / 50


def leaning(upright: float = -1.0) -> np.ndarray:
    """Gravity of a trunk that rolls a little as it walks; upright: its third component when it does not."""
    roll = 0.1 * np.sin(2 * np.pi * 2.0 * WALK)
    return np.stack([np.zeros_like(roll), np.sin(roll), upright * np.cos(roll)], axis=1)


def walked(gravity: np.ndarray, speed: float | np.ndarray = 2.0, fell: bool = False, **settings: object):
    """A log of joints that swing at 2 Hz with up to `speed` rad/s, and of gravity. settings: of its mapping."""
    velocity = speed * np.cos(2 * np.pi * 2.0 * WALK)
    columns = {"t": 20.0 * np.arange(len(WALK)), "hip": velocity, "knee": -velocity}
    columns |= dict(zip("xyz", gravity.T, strict=True))
    mapping = {
        "time": {"column": "t", "unit": "ms"},
        "rate_hz": 50,
        "channels": {
            "joint_velocity": {"columns": "{joint}", "unit": "rad/s"},
            "projected_gravity": {"columns": ["x", "y", "z"], "unit": "1", "real": False, **settings},
        },
        "recording": {"fell": fell},
    }
    return recording_from_columns([Path("01.csv")], mapping, TWO_JOINTS, lambda path: columns)


def test_a_walk_whose_gravity_points_up_is_refused_with_the_line_to_write():
    with pytest.raises(RecordingError) as told:
        walked(leaning(upright=1.0))
    assert str(told.value) == (
        "01.csv: 'projected_gravity' has z at +1 (median of 10 s in which the joints move), as of one that moves "
        "upside down. Expected (0, 0, -1) of an upright robot, by which falls are told. Is it mounted upside down (an "
        "arm on a ceiling), or does it climb? Then this is right: say so with `limits`, and of one that lay on its "
        "back recording.fell: true. Else the log probably has the up vector: say sign: -1 of it in the mapping (of a "
        "trunk frame whose z points down, turn y and z in the log instead)."
    )
    upright = walked(leaning(upright=1.0), sign=-1)
    assert upright.values("projected_gravity")[:, 2].max() < -0.9


def test_one_sign_too_many_is_told_as_that():
    with pytest.raises(
        RecordingError, match="mounted upside down .* Else the mapping turns it over .sign or scale.: leave that out"
    ):
        walked(leaning(), sign=-1)


def test_a_fall_late_in_such_a_log_changes_nothing():
    gravity = leaning(upright=1.0)
    gravity[400:] = [0.0, 0.0, -1.0]  # on its back, as an up vector has it
    with pytest.raises(RecordingError, match="upside down"):
        walked(gravity)


def test_a_robot_that_turned_over_and_kicks_for_the_rest_is_read_as_it_is():
    gravity = leaning()
    gravity[100:] = [0.0, 0.0, 1.0]
    walked(gravity)


@pytest.mark.parametrize("settings", [{"fell": True}, {"limits": [-1.01, 1.01]}, {"speed": 0.1}])
def test_a_robot_that_fell_or_hangs_or_stands_may_be_upside_down(settings):
    walked(leaning(upright=1.0), **settings)


def test_a_moment_of_moving_tells_nothing():
    walked(leaning(upright=1.0), speed=np.where(WALK < 0.8, 2.0, 0.0))


def test_missing_values_are_another_check_s_to_tell():
    one = walked(leaning(upright=1.0), limits=[-1.01, 1.01])
    with pytest.raises(RecordingError, match="upside down"):
        check_upright(one, "01.csv")
    one.channels["projected_gravity"].values[250, 2] = np.nan
    check_upright(one, "01.csv")
    check_gravity(one.channels, "01.csv")
