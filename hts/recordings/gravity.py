"""Whether `projected_gravity` is the unit vector that it is taken for: falls are told by its third component alone."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from hts.errors import RecordingError
from hts.recordings.recording import Series

GRAVITY = "projected_gravity"
TOLERANCE = 0.1
"""By which the median of its length may differ from 1: noise of a sample, and single impacts, do not move it so far."""
EARTH = 9.81
"""m/s^2, at which the median lies where an accelerometer's readings were taken as they are."""


def check_gravity(channels: Mapping[str, Series], where: str) -> None:
    """Raise RecordingError where `projected_gravity` is not of length 1. where: begins the message.

    In m/s^2 a robot that lies on its side, z = -0.1 of 1, reads -1, which is upright.
    """
    if GRAVITY not in channels or channels[GRAVITY].values.shape[1:] != (3,):
        return
    values = channels[GRAVITY].values.astype(np.float64)
    length = float(np.median(np.sqrt((values**2).sum(axis=1))))
    if abs(length - 1.0) <= TOLERANCE:
        return
    if length < 1e-3:
        hint = "these are no attitude: correct its columns"
    elif abs(length / EARTH - 1.0) <= TOLERANCE:
        hint = f"it looks like m/s^2: say scale: {1 / EARTH:.3g} of it in the mapping"
        if np.median(values[:, 2]) > 0:
            hint += ", and sign: -1 if it is an accelerometer's, which reads upwards what gravity pulls down"
    else:
        hint = f"correct its columns, or say scale: {1 / length:.3g} of it in the mapping if it is in another unit"
    raise RecordingError(
        f"{where}: '{GRAVITY}' is {length:.3g} long (median of {len(values)} samples). Expected a unit vector, "
        f"(0, 0, -1) of an upright robot, by which falls are told; {hint}."
    )
