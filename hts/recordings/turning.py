"""Whether `angular_velocity` is how the trunk turns: a gyroscope in deg/s, counted the other way, or along other axes
(`axes`), shows no limit.

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

import numpy as np

from hts.errors import RecordingError
from hts.recordings.axes import other_axes
from hts.recordings.gravity import GRAVITY
from hts.recordings.motion import ALIKE, OTHER_UNIT, UNLIKE, correlations
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
LEAST_HZ, MOST_FAST = 20.0, 0.5
"""Slower samples tell nothing: a trot rocks with 2 to 3 Hz and twice that. Nor does a trunk whose turning has so much
of its squares above a quarter of the rate, where what is faster than half of it is folded to."""


def check_turning(channels: Mapping[str, Series], rate_hz: float, where: str, stated: Collection[str] = ()) -> None:
    """Raise RecordingError where `angular_velocity` is not how `projected_gravity` turns, saying what it looks like.

    rate_hz: of the samples; where: begins the message; stated: names of channels whose limits a mapping states, which
    is a person's word for them. Nothing is said of a trunk that hardly turns, or faster than the samples tell, nor
    where the two do not go together, or do with one of them late.
    """
    if rate_hz < LEAST_HZ:
        return
    names = (GRAVITY, TURNING)
    if any(name not in channels or name in stated or channels[name].values.shape[1:] != (3,) for name in names):
        return
    if channels[TURNING].channel.unit != "rad/s" or len(channels[GRAVITY].values) < LEAST_SECONDS * rate_hz:
        return
    gravity, velocity = (averaged(channels[name].values, round(OVER_SECONDS * rate_hz)) for name in names)
    seen, told = np.gradient(gravity, 1.0 / rate_hz, axis=0)[:, :2], np.cross(gravity, velocity)[:, :2]
    seen_size, told_size = seen.std(axis=0), told.std(axis=0)
    if seen_size.min() < TURNS or told_size.min() < TURNS / OTHER_UNIT:
        return
    if max(_fast(seen), _fast(told)) > MOST_FAST:
        return
    alike = correlations(seen, told)
    ratio = float(np.median(told_size / seen_size))
    if alike.min() < -ALIKE and np.abs(alike).min() < _late(seen, told, round(LATE_SECONDS * rate_hz)) + CLEARLY:
        return
    if alike.max() < -ALIKE:
        hint = f"it is counted the other way: say sign: -1 of '{TURNING}'"
    elif (alike.mean() > UNLIKE and ratio > OTHER_UNIT) or (alike.min() > ALIKE and ratio < 1 / OTHER_UNIT):
        hint = (
            f"it is {ratio:.3g} times as large, in another unit (deg/s are 57 times rad/s): correct its unit or scale"
        )
    elif np.abs(alike).min() > ALIKE and alike.min() < 0:
        hint = "of x and y one is counted the other way, so the two are along other axes: turn one of them in the log"
    else:
        most = round(LATE_SECONDS * rate_hz)
        other = other_axes(seen, gravity, velocity, rate_hz, lambda one, another: _late(one, another, most))
        if other is None:
            return
        hint = other
    raise RecordingError(
        f"{where}: '{TURNING}' is not how '{GRAVITY}' turns in the trunk's frame (correlation {alike[0]:.2f} and "
        f"{alike[1]:.2f}): {hint}; if it is right, say so with `limits`."
    )


def _late(seen: np.ndarray, told: np.ndarray, most: int) -> float:
    """Correlation of the component that fits worse, at the delay of up to `most` samples, either way, where that is
    highest. seen, told: (T, 2), 1/s."""
    fits = [correlations(seen, told)]
    for by in range(1, most + 1):
        fits += [correlations(seen[by:], told[:-by]), correlations(seen[:-by], told[by:])]
    return float(np.min(fits, axis=1).max())


def _fast(turning: np.ndarray) -> float:
    """Share of the squares above a quarter of the rate, of the component of (T, 2) where it is larger."""
    squares = np.abs(np.fft.rfft(turning - turning.mean(axis=0), axis=0)) ** 2
    above = np.fft.rfftfreq(len(turning)) > 1 / 4  # periods a sample
    return float((squares[above].sum(axis=0) / squares.sum(axis=0)).max())


def averaged(values: np.ndarray, samples: int) -> np.ndarray:
    """Values (T, 3) averaged twice over so many samples, shorter by them."""
    window = np.ones(max(samples, 1)) / max(samples, 1)
    columns = [np.convolve(np.convolve(one, window, "valid"), window, "valid") for one in values.astype(np.float64).T]
    return np.stack(columns, axis=1)
