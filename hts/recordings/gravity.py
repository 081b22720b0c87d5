"""Whether `projected_gravity` is the unit vector, pointing down, that it is taken for: falls are told by its third
component alone."""

from __future__ import annotations

from collections.abc import Collection, Mapping

import numpy as np

from hts.errors import RecordingError
from hts.recordings.recording import Recording, Series
from hts.recordings.repeated import moving

GRAVITY = "projected_gravity"
TOLERANCE = 0.1
"""By which the median of its length may differ from 1: noise of a sample, and single impacts, do not move it so far."""
EARTH = 9.81
"""m/s^2, at which the median lies where an accelerometer's readings were taken as they are."""
UPSIDE_DOWN = 0.5
"""z from which on the trunk is tilted by 120 degrees and more: nobody walks so."""
BEGINS_SECONDS, LEAST_SECONDS = 1.0, 3.0
"""Of moving. A robot that turns over begins upright; less than the second tells nothing."""


def check_gravity(channels: Mapping[str, Series], where: str) -> None:
    """Raise RecordingError where `projected_gravity` is not of length 1. where: begins the message.

    In m/s^2 a robot that lies on its side, z = -0.1 of 1, reads -1, which is upright.
    """
    if GRAVITY not in channels or channels[GRAVITY].values.shape[1:] != (3,):
        return
    values = channels[GRAVITY].values.astype(np.float64)
    length = float(np.median(np.sqrt((values**2).sum(axis=1))))
    if not abs(length - 1.0) > TOLERANCE:  # nor is anything said of values that are missing, NaN
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


def check_upright(recording: Recording, where: str, stated: Collection[str] = (), turned: bool = False) -> None:
    """Raise RecordingError where `projected_gravity` has the robot walk upside down from the beginning: the up vector.

    where: begins the message; stated: names of channels whose limits a mapping states, which is a person's word for
    them; turned: whether the mapping already turns it over (sign or scale). Only samples in which the joints move
    count: they lie upside down at the median, and in the first second. Nothing is said of a log without joints, of one
    that hardly moves, nor of a fall.
    """
    channels = recording.channels
    if recording.fell or GRAVITY in stated or GRAVITY not in channels or channels[GRAVITY].values.shape[1:] != (3,):
        return
    walks = moving(channels, recording.rate_hz)
    if walks is None or walks.sum() < LEAST_SECONDS * recording.rate_hz:
        return
    down = channels[GRAVITY].values[walks, 2].astype(np.float64)
    median, first = float(np.median(down)), float(np.median(down[: round(BEGINS_SECONDS * recording.rate_hz)]))
    if not (median > UPSIDE_DOWN and first > UPSIDE_DOWN):  # nor of values that are missing, NaN
        return
    if turned:
        hint = "the mapping turns it over (sign or scale): leave that out"
    else:
        hint = (
            "the log probably has the up vector: say sign: -1 of it in the mapping (of a trunk frame whose z points "
            "down, turn y and z in the log instead)"
        )
    raise RecordingError(
        f"{where}: '{GRAVITY}' has z at {median:+.2g} (median of {len(down) / recording.rate_hz:.3g} s in which the "
        f"joints move), as of one that moves upside down. Expected (0, 0, -1) of an upright robot, by which falls are "
        "told. Is it mounted upside down (an arm on a ceiling), or does it climb? Then this is right: say so with "
        f"`limits`, and of one that lay on its back recording.fell: true. Else {hint}."
    )
