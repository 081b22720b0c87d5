"""A gyroscope along other axes than the trunk's, and gravity that stays as it is in the world's."""

from __future__ import annotations

import numpy as np
import pytest
from walker_recording import a_recording

from hts.channels import Channel
from hts.errors import RecordingError
from hts.recordings import Series
from hts.recordings.attitude import still_notes
from hts.recordings.turning import check_turning

RATE, SAMPLES = 50, 1000
WHEN = np.arange(SAMPLES) / RATE


def rocking(turns: float = 0.0, noise: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Gravity and angular velocity (T, 3) of a trunk that rolls and pitches with rhythms of their own, and turns."""
    roll, pitch = 0.06 * np.sin(2 * np.pi * 1.1 * WHEN), 0.05 * np.sin(2 * np.pi * 1.7 * WHEN + 1.0)
    gravity = np.stack([np.sin(pitch), -np.cos(pitch) * np.sin(roll), -np.cos(pitch) * np.cos(roll)], axis=1)
    rolls, pitches = np.gradient(roll, 1 / RATE), np.gradient(pitch, 1 / RATE)
    around = np.full(SAMPLES, turns)
    velocity = [
        rolls - around * np.sin(pitch),
        np.cos(roll) * pitches + around * np.sin(roll) * np.cos(pitch),
        around * np.cos(roll) * np.cos(pitch) - np.sin(roll) * pitches,
    ]
    rng = np.random.default_rng(4)
    return gravity, np.stack(velocity, axis=1) + noise * rng.standard_normal((SAMPLES, 3))


def channels(gravity: np.ndarray, velocity: np.ndarray) -> dict[str, Series]:
    told = {"projected_gravity": (gravity, "1"), "angular_velocity": (velocity, "rad/s")}
    return {name: Series(Channel(name, unit, (3,)), values) for name, (values, unit) in told.items()}


def look(gravity: np.ndarray, velocity: np.ndarray, stated: tuple[str, ...] = ()) -> None:
    check_turning(channels(gravity, velocity), RATE, "01.csv", stated)


def about_z(velocity: np.ndarray, angle: np.ndarray) -> np.ndarray:
    cos, sin = np.cos(angle), np.sin(angle)
    x, y, z = velocity.T
    return np.stack([cos * x - sin * y, sin * x + cos * y, z], axis=1)


@pytest.mark.parametrize(
    ("order", "told"),
    [([1, 0, 2], "x and y being its y and x"), ([2, 1, 0], "its z and y"), ([1, 2, 0], "its z and x")],
)
def test_exchanged_columns_are_refused_with_which_they_are(order, told):
    gravity, velocity = rocking(noise=0.05)
    look(gravity, velocity)
    with pytest.raises(RecordingError) as refused:
        look(gravity, velocity[:, order])
    assert told in str(refused.value) and "\n" not in str(refused.value)
    assert "expected are the trunk's own axes" in str(refused.value)
    look(gravity, velocity[:, order], stated=("angular_velocity",))


def test_the_axes_of_the_world_are_told_of_a_trunk_that_turns_away_from_them():
    gravity, velocity = rocking(turns=0.4)
    look(gravity, velocity)
    heading = np.cumsum(velocity[:, 2]) / RATE
    for start in (0.0, 2.0):
        with pytest.raises(RecordingError, match="in the axes of the world, which the trunk turns away from"):
            look(gravity, about_z(velocity, heading + start))
    gravity, velocity = rocking()
    look(gravity, about_z(velocity, np.cumsum(velocity[:, 2]) / RATE))
    look(gravity, about_z(velocity, np.full(SAMPLES, 0.2)))
    with pytest.raises(RecordingError, match="turned by about 68 degrees about z"):
        look(gravity, about_z(velocity, np.full(SAMPLES, 1.2)))


def test_noise_and_a_gyroscope_of_another_machine_look_like_no_other_axes():
    gravity, velocity = rocking()
    rng = np.random.default_rng(2)
    look(gravity, 0.3 * rng.standard_normal(velocity.shape))
    look(gravity, velocity + 1.5 * rng.standard_normal(velocity.shape))
    look(gravity, np.roll(velocity, 10, axis=0))
    look(gravity, velocity * [1.0, 0.0, 1.0])


def walks(gravity: np.ndarray, velocity: np.ndarray, speed: float = 2.0):
    swing = speed * np.sin(2 * np.pi * 2.0 * WHEN)
    joints = Series(Channel("joint_velocity", "rad/s", (2,)), np.stack([swing, -swing], axis=1))
    return a_recording(SAMPLES).replace(channels={**channels(gravity, velocity), "joint_velocity": joints})


def test_gravity_that_stays_as_it_is_while_the_trunk_rocks_is_noted():
    gravity, velocity = rocking()
    still = np.tile([0.0, 0.0, -1.0], (SAMPLES, 1))
    assert still_notes(walks(gravity, velocity)) == {}
    note = still_notes(walks(still, velocity))["gravity_stands_still"]
    assert "20 s of moving" in note and "is it in those of the world, or was the attitude not read?" in note
    assert still_notes(walks(still, velocity), stated={"projected_gravity"}) == {}
    assert still_notes(walks(still, velocity, speed=0.1)) == {}
    assert still_notes(walks(still, 0.02 * velocity)) == {}
    assert still_notes(walks(still + 0.002 * np.random.default_rng(0).standard_normal(still.shape), velocity)) == {}
