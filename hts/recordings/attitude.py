"""Whether `projected_gravity` moves at all: in the axes of the world it is (0, 0, -1) of a robot that lies on its side,
too, and so is an attitude that nobody reads."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from hts.recordings.gravity import GRAVITY, LEAST_SECONDS
from hts.recordings.recording import Recording
from hts.recordings.repeated import moving
from hts.recordings.turning import OVER_SECONDS, TURNING, averaged

SAME, ROCKS = 1e-3, 0.05
"""Standard deviation, of all its components, below which it stands still, and of the angular velocity about x and y,
rad/s, averaged over 0.1 s twice, from which on a trunk rocks: walks have 0.05 to 0.3."""
MORE = 1.5
"""Times what would be left of its deviation if all of that were noise from sample to sample."""


def still_notes(recording: Recording, stated: Collection[str] = ()) -> dict[str, str]:
    """A note where `projected_gravity` stays as it is while the trunk rocks, by its `angular_velocity`: gravity in the
    axes of the world, or an attitude that nobody reads, and no fall would be told by it.

    stated: names of channels whose limits a mapping states, which is a person's word for them. Nothing is said of a
    log whose joints hardly move.
    """
    channels = recording.channels
    if GRAVITY in stated or any(
        name not in channels or channels[name].values.shape[1:] != (3,) for name in (GRAVITY, TURNING)
    ):
        return {}
    walks = moving(channels, recording.rate_hz)
    if walks is None or walks.sum() < LEAST_SECONDS * recording.rate_hz:
        return {}
    if channels[TURNING].channel.unit != "rad/s" or not channels[GRAVITY].values[walks].std(axis=0).max() < SAME:
        return {}
    about, samples = channels[TURNING].values[walks].astype(np.float64), max(1, round(OVER_SECONDS * recording.rate_hz))
    rocks = _beside_z(averaged(about, samples)).std(axis=0)
    window = np.ones(samples) / samples
    noise = float(np.linalg.norm(np.convolve(window, window))) * about[:, :2].std(axis=0)  # if it were nothing else
    if not (rocks > np.maximum(ROCKS, MORE * noise)).any():
        return {}
    return {
        "gravity_stands_still": (
            f"projected_gravity stays within {SAME:g} of one value in {walks.sum() / recording.rate_hz:.3g} s of "
            f"moving, though angular_velocity about x and y varies by {rocks.max():.2g} rad/s, and falls are told by "
            "it. Expected is gravity in the axes of the trunk: is it in those of the world, or was the attitude not "
            "read?"
        )
    }


def _beside_z(velocity: np.ndarray) -> np.ndarray:
    """Components x and y (T, 2) of a velocity (T, 3) without what goes with z, as of a sensor that is mounted askew."""
    x_y, z = velocity[:, :2] - velocity[:, :2].mean(axis=0), velocity[:, 2] - velocity[:, 2].mean()
    size = float(z @ z)
    return x_y - np.outer(z, z @ x_y / size) if size > 0 else x_y
