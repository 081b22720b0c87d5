"""An angular velocity that is not how gravity turns in the trunk's frame is refused with what it looks like."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from two_joint_log import TWO_JOINTS

from hts.errors import RecordingError
from hts.recordings.logs import recording_from_columns

RATE = 50
TIMES = np.arange(10 * RATE) / RATE
ROLL, PITCH = 0.1 * np.sin(2 * np.pi * 1.0 * TIMES), 0.05 * np.sin(2 * np.pi * 1.3 * TIMES + 1.0)
GRAVITY = np.stack([np.sin(PITCH), -np.cos(PITCH) * np.sin(ROLL), -np.cos(PITCH) * np.cos(ROLL)], axis=1)
"""Of a trunk that first pitches (about y, nose down), then rolls (about x, to its right), rad."""
ROLLS, PITCHES = np.gradient(ROLL, 1 / RATE), np.gradient(PITCH, 1 / RATE)
GYRO = np.stack([ROLLS, np.cos(ROLL) * PITCHES, -np.sin(ROLL) * PITCHES], axis=1)


def imported(gyro: np.ndarray, gravity: np.ndarray = GRAVITY, **settings: object):
    """A log of a trunk's attitude and gyroscope. settings: of the gyroscope's mapping."""
    columns = {"t": 20.0 * np.arange(len(gyro))}
    for name, values in (("g", gravity), ("w", gyro)):
        columns |= {f"{name}{axis}": values[:, at] for at, axis in enumerate("xyz")}
    mapping = {
        "time": {"column": "t", "unit": "ms"},
        "rate_hz": RATE,
        "channels": {
            "projected_gravity": {"columns": ["gx", "gy", "gz"], "unit": "1", "real": False},
            "angular_velocity": {"columns": ["wx", "wy", "wz"], "unit": "rad/s", "real": False, **settings},
        },
    }
    return recording_from_columns([Path("01.csv")], mapping, TWO_JOINTS, lambda path: columns)


def test_a_gyroscope_that_agrees_with_gravity_is_taken_noise_and_all():
    imported(GYRO)
    imported(GYRO + 0.2 * np.random.default_rng(1).standard_normal(GYRO.shape))


def test_degrees_a_second_are_refused_with_how_much_larger_they_are():
    with pytest.raises(RecordingError) as told:
        imported(np.degrees(GYRO))
    assert str(told.value) == (
        "01.csv: 'angular_velocity' is not how 'projected_gravity' turns in the trunk's frame (correlation 1.00 and "
        "1.00): it is 57.3 times as large, in another unit (deg/s are 57 times rad/s): correct its unit or scale; if "
        "it is right, say so with `limits`."
    )


@pytest.mark.parametrize(
    ("gyro", "told"),
    [
        (-GYRO, "it is counted the other way: say sign: -1 of 'angular_velocity'"),
        (-np.degrees(GYRO), "it is counted the other way"),
        (GYRO * [1.0, -1.0, -1.0], "of x and y one is counted the other way"),
        (GYRO / (2 * np.pi), "it is 0.159 times as large"),
    ],
)
def test_other_signs_and_units_are_told_apart(gyro, told):
    with pytest.raises(RecordingError, match=told):
        imported(gyro)


def test_degrees_are_told_of_a_noisy_attitude_too_and_noise_alone_is_no_unit():
    shaken = GRAVITY + 0.1 * np.random.default_rng(3).standard_normal(GRAVITY.shape)
    imported(GYRO, gravity=shaken)
    with pytest.raises(RecordingError, match="in another unit"):
        imported(np.degrees(GYRO), gravity=shaken)


def test_which_way_gravity_points_does_not_matter():
    imported(GYRO, gravity=-GRAVITY)
    with pytest.raises(RecordingError, match="57.3 times as large"):
        imported(np.degrees(GYRO), gravity=-GRAVITY)


def test_a_person_may_say_that_it_is_right():
    imported(np.degrees(GYRO), limits=[-500, 500])


def test_nothing_is_said_of_a_trunk_that_hardly_turns_or_of_what_does_not_go_together():
    imported(np.degrees(GYRO), gravity=np.tile([0.0, 0.0, -1.0], (len(TIMES), 1)))
    imported(np.degrees(GYRO[:100]), gravity=GRAVITY[:100])
    imported(np.random.default_rng(2).standard_normal(GYRO.shape))
