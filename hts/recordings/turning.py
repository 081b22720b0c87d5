"""Whether `angular_velocity` is how the trunk turns: a gyroscope in deg/s, or counted the other way, shows no limit.

Gravity g is fixed in the world, so in the trunk's frame it turns against it: dg/dt = g x w. Its components along x and
y are held against each other, both averaged over 0.1 s twice, since a derivative makes noise large. Which way g points
does not matter: both sides turn over with it.

Where the numbers come from: on two public logs of a walking quadruped (its roll, pitch and gyroscope; those of
tests/recordings/test_real_logs.py) the correlation is 0.95 to 0.98 for each component, with w 1.0 to 1.2 times as large
as it must be; on two simulated walks 0.84 to 0.97 and 0.9 to 1.0. Of 20 drawn robots, some of a very noisy gravity,
they go down to 0.16 and 0.2: noise of gravity makes w look too small, but never too large, and none that is as it must
be was refused.

An attitude that an estimator gives late looks like one counted the other way where the trunk rocks periodically, and
rocking that is faster than the samples looks like slower: a sign is refused only where no delay explains it.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass

import numpy as np

from hts.errors import RecordingError
from hts.recordings.gravity import GRAVITY
from hts.recordings.motion import ALIKE, MOST_FAST, OTHER_UNIT, UNLIKE, correlations, share_of_fast
from hts.recordings.recording import Series

TURNING = "angular_velocity"
OVER_SECONDS, LEAST_SECONDS = 0.1, 3.0
"""Over so many both are averaged; a shorter log tells nothing."""
TURNS = 0.03
"""1/s of standard deviation: with less the trunk hardly turns."""
LATE_SECONDS, CLEARLY = 0.3, 0.3
"""By up to so many one of the two may be late (or early). Turned over, they must correlate by so much more than they do
as they are at the best of these delays: on the walks above by 0.37 to 0.92 more, where an attitude is late and a trunk
rocks periodically by 0 at most."""
LEAST_HZ = 20.0
"""Slower samples tell nothing: a trot rocks with 2 to 3 Hz and twice that."""


@dataclass(frozen=True)
class Turn:
    """How a trunk turned by its gravity and by its gyroscope.

    gravity, velocity: unit and rad/s, (T, 3), averaged alike; seen, told: how gravity turns along x and y by either,
    1/s, (T, 2); alike: their correlation, (2,).
    """

    gravity: np.ndarray
    velocity: np.ndarray
    seen: np.ndarray
    told: np.ndarray
    alike: np.ndarray


def turn_of(channels: Mapping[str, Series], rate_hz: float, stated: Collection[str] = ()) -> Turn | None:
    """Both, where they can be held against each other: not of a trunk that hardly turns, or faster than the samples
    tell, nor where they look turned over and one of them is late."""
    if rate_hz < LEAST_HZ:
        return None
    names = (GRAVITY, TURNING)
    if any(name not in channels or name in stated or channels[name].values.shape[1:] != (3,) for name in names):
        return None
    if channels[TURNING].channel.unit != "rad/s" or len(channels[GRAVITY].values) < LEAST_SECONDS * rate_hz:
        return None
    gravity, velocity = (averaged(channels[name].values, round(OVER_SECONDS * rate_hz)) for name in names)
    seen, told = np.gradient(gravity, 1.0 / rate_hz, axis=0)[:, :2], np.cross(gravity, velocity)[:, :2]
    if seen.std(axis=0).min() < TURNS or told.std(axis=0).min() < TURNS / OTHER_UNIT:
        return None
    if max(share_of_fast(seen), share_of_fast(told)) > MOST_FAST:
        return None
    alike = correlations(seen, told)
    if alike.min() < -ALIKE and np.abs(alike).min() < at_best(seen, told, rate_hz) + CLEARLY:
        return None
    return Turn(gravity, velocity, seen, told, alike)


def check_turning(channels: Mapping[str, Series], rate_hz: float, where: str, stated: Collection[str] = ()) -> None:
    """Raise RecordingError where `angular_velocity` is not how `projected_gravity` turns but for a sign or a unit,
    saying which.

    rate_hz: of the samples; where: begins the message; stated: names of channels whose limits a mapping states, which
    is a person's word for them. Nothing is said of a trunk that hardly turns, or faster than the samples tell, nor
    where the two do not go together, or do with one of them late.
    """
    found = turn_of(channels, rate_hz, stated)
    if found is None:
        return
    alike, ratio = found.alike, float(np.median(found.told.std(axis=0) / found.seen.std(axis=0)))
    if alike.max() < -ALIKE:
        hint = f"it is counted the other way: say sign: -1 of '{TURNING}'"
    elif (alike.mean() > UNLIKE and ratio > OTHER_UNIT) or (alike.min() > ALIKE and ratio < 1 / OTHER_UNIT):
        hint = (
            f"it is {ratio:.3g} times as large, in another unit (deg/s are 57 times rad/s): correct its unit or scale"
        )
    elif np.abs(alike).min() > ALIKE and alike.min() < 0:
        hint = "of x and y one is counted the other way, so the two are along other axes: turn one of them in the log"
    else:
        return
    raise RecordingError(
        f"{where}: '{TURNING}' is not how '{GRAVITY}' turns in the trunk's frame (correlation {alike[0]:.2f} and "
        f"{alike[1]:.2f}): {hint}; if it is right, say so with `limits`."
    )


def at_best(seen: np.ndarray, told: np.ndarray, rate_hz: float) -> float:
    """Correlation of the component that fits worse, at the delay of up to LATE_SECONDS, either way, where that is
    highest. seen, told: (T, 2), 1/s."""
    fits, most = [correlations(seen, told)], round(LATE_SECONDS * rate_hz)
    for by in range(1, most + 1):
        fits += [correlations(seen[by:], told[:-by]), correlations(seen[:-by], told[by:])]
    return float(np.min(fits, axis=1).max())


def averaged(values: np.ndarray, samples: int) -> np.ndarray:
    """Values (T, 3) averaged twice over so many samples, shorter by them."""
    window = np.ones(max(samples, 1)) / max(samples, 1)
    columns = [np.convolve(np.convolve(one, window, "valid"), window, "valid") for one in values.astype(np.float64).T]
    return np.stack(columns, axis=1)
