"""An angular velocity that is not how gravity turns in the trunk's frame is refused with what it looks like."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from two_joint_log import TWO_JOINTS

from hts.channels import Channel
from hts.errors import RecordingError
from hts.recordings import Series
from hts.recordings.logs import check_turning, recording_from_columns

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


# ------------------------------------------------------------------------------ late attitudes, and rates that are low


def rocking(roll_hz: float, pitch_hz: float, rate: float = RATE, late: float = 0.0, seconds: float = 20.0):
    """Gravity, unit, and gyroscope, rad/s, (T, 3) each, of a trunk that rocks periodically, as samples at `rate` have
    them. late: s by which the attitude comes after the gyroscope."""

    def angles(when: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return 0.06 * np.sin(2 * np.pi * roll_hz * when), 0.03 * np.sin(2 * np.pi * pitch_hz * when + 1.0)

    times, step = np.arange(round(seconds * rate)) / rate, 1e-5
    roll, pitch = angles(times - late)
    gravity = np.stack([np.sin(pitch), -np.cos(pitch) * np.sin(roll), -np.cos(pitch) * np.cos(roll)], axis=1)
    (before, low), (after, high) = angles(times - step), angles(times + step)
    rolls, pitches, roll = (after - before) / (2 * step), (high - low) / (2 * step), angles(times)[0]
    return gravity, np.stack([rolls, np.cos(roll) * pitches, -np.sin(roll) * pitches], axis=1)


def look(gravity: np.ndarray, gyro: np.ndarray, rate: float = RATE) -> None:
    told = {"projected_gravity": (gravity, "1"), "angular_velocity": (gyro, "rad/s")}
    channels = {name: Series(Channel(name, unit, (3,)), values) for name, (values, unit) in told.items()}
    check_turning(channels, rate, "01.csv")


@pytest.mark.parametrize(
    ("roll_hz", "pitch_hz", "late"),
    [(2.2, 4.4, 0.2), (2.2, 4.4, 0.25), (2.5, 2.5, 0.2), (1.8, 1.8, 0.25), (3, 3, 0.15)],
)
@pytest.mark.parametrize("other", [1.0, -1.0])
def test_a_late_attitude_of_a_trunk_that_rocks_periodically_is_no_other_sign(roll_hz, pitch_hz, late, other):
    """Half of a period late it is the negative. other: -1, it is the gyroscope that is late."""
    look(*rocking(roll_hz, pitch_hz, late=other * late))


def test_a_late_attitude_does_not_hide_degrees_or_another_sign_of_a_slow_trunk():
    gravity, gyro = rocking(0.9, 1.2, late=0.1)
    look(gravity, gyro)
    with pytest.raises(RecordingError, match="in another unit"):
        look(gravity, np.degrees(gyro))
    gravity, gyro = rocking(0.9, 1.2, late=0.02)
    with pytest.raises(RecordingError, match="counted the other way"):
        look(gravity, -gyro)


@pytest.mark.parametrize(("roll_hz", "pitch_hz", "rate"), [(3, 6, 10), (3, 6, 12.5), (3.5, 7, 12.5), (26, 26, 20)])
def test_rocking_that_is_too_fast_for_the_samples_tells_nothing(roll_hz, pitch_hz, rate):
    """At 10 Hz 6 Hz look like 4 Hz the other way round, and 26 Hz at 20 Hz are 6 Hz that turn too fast."""
    look(*rocking(roll_hz, pitch_hz, rate=rate), rate=rate)


def test_missing_values_are_another_check_s_to_tell():
    gyro = np.degrees(GYRO)
    gyro[7, 1] = np.nan
    look(GRAVITY, gyro)
