"""A gyroscope along other axes than the trunk's, and gravity that stays as it is in the world's."""

from __future__ import annotations

import numpy as np
import pytest
from walker_recording import a_recording

from hts.channels import Channel
from hts.recordings import Series
from hts.recordings.attitude import still_notes
from hts.recordings.axes import axes_notes
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


def look(gravity: np.ndarray, velocity: np.ndarray, stated: tuple[str, ...] = ()) -> str:
    """What is noted; nothing is refused."""
    check_turning(channels(gravity, velocity), RATE, "01.csv", stated)
    return axes_notes(channels(gravity, velocity), RATE, stated).get("angular_velocity_axes", "")


def about_z(velocity: np.ndarray, angle: np.ndarray) -> np.ndarray:
    cos, sin = np.cos(angle), np.sin(angle)
    x, y, z = velocity.T
    return np.stack([cos * x - sin * y, sin * x + cos * y, z], axis=1)


@pytest.mark.parametrize(
    ("order", "told"),
    [([1, 0, 2], "x and y being its y and x"), ([2, 1, 0], "its z and y"), ([1, 2, 0], "its z and x")],
)
def test_exchanged_columns_are_noted_with_which_they_are(order, told):
    gravity, velocity = rocking(noise=0.05)
    assert not look(gravity, velocity)
    note = look(gravity, velocity[:, order])
    assert told in note and "\n" not in note
    assert "expected are the trunk's own axes" in note and "may have been taken for gravity" in note
    assert not look(gravity, velocity[:, order], stated=("angular_velocity",))


def test_the_axes_of_the_world_are_told_of_a_trunk_that_turns_away_from_them():
    gravity, velocity = rocking(turns=0.4)
    assert not look(gravity, velocity)
    heading = np.cumsum(velocity[:, 2]) / RATE
    for start in (0.0, 2.0):
        told = look(gravity, about_z(velocity, heading + start))
        assert "in the axes of the world, which the trunk turns away from" in told
    gravity, velocity = rocking()
    assert not look(gravity, about_z(velocity, np.cumsum(velocity[:, 2]) / RATE))
    assert not look(gravity, about_z(velocity, np.full(SAMPLES, 0.2)))
    assert "turned by about 68 degrees about z" in look(gravity, about_z(velocity, np.full(SAMPLES, 1.2)))


def test_noise_and_a_gyroscope_of_another_machine_look_like_no_other_axes():
    gravity, velocity = rocking()
    rng = np.random.default_rng(2)
    assert not look(gravity, 0.3 * rng.standard_normal(velocity.shape))
    assert not look(gravity, velocity + 1.5 * rng.standard_normal(velocity.shape))
    assert not look(gravity, np.roll(velocity, 10, axis=0))
    assert not look(gravity, velocity * [1.0, 0.0, 1.0])


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


def test_noise_of_a_gyroscope_or_one_that_is_mounted_askew_is_no_rocking():
    """A machine on wheels: its trunk does not rock, whatever the sensor says."""
    still, rng = np.tile([0.0, 0.0, -1.0], (SAMPLES, 1)), np.random.default_rng(3)
    quiet = np.zeros((SAMPLES, 3))
    assert still_notes(walks(still, quiet + 0.15 * rng.standard_normal(quiet.shape))) == {}
    spin = 2.0 * np.sin(2 * np.pi * 0.3 * WHEN)
    askew = spin[:, None] * [np.sin(0.05), 0.0, np.cos(0.05)] + 0.01 * rng.standard_normal(quiet.shape)
    assert still_notes(walks(still, askew)) == {}
