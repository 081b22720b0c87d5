"""How late a gauge shows what it measures, from recordings alone.

The gauge is explained, by least squares, from what the joints do (every input, its size, its square, and products of
inputs of one shape such as torque times velocity), shifted by each lag in turn. The lag that explains most is the
estimate; lags that explain nearly as much are its interval. No gauge shows what is still to come: where that explains
it clearly better than any lag, its stamps and those of the joints are of two clocks, and the lag is negative.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hts.errors import RecordingError, unknown_name
from hts.recordings.recording import Recording

LONGEST_SECONDS = 1.0
LEAST_R2 = 0.1
"""Below it the joints do not explain the gauge, so no lag can be told."""
NEARLY = 0.02
"""Lags whose R² is within so much of the best one's are as good."""
EARLY_SECONDS = 0.05
"""Filtered velocities are late by a sample or two, and make a gauge early by so much at most."""
CLEARLY = 0.1
"""By so much of its R² a lag of less than nothing must be better than all others."""
RIDGE = 1e-3


@dataclass(frozen=True)
class Lag:
    """seconds: how late the gauge is, below 0 for one that is early; low, high: lags that explain it as well; r2:
    there; r2_at_zero: without a lag."""

    seconds: float
    low: float
    high: float
    r2: float
    r2_at_zero: float

    def __str__(self) -> str:
        found = f"{self.seconds:.3g} s ({self.low:.3g} to {self.high:.3g} s fit as well)"
        found = f"{found}, R² {self.r2:.2f}, without a lag {self.r2_at_zero:.2f}"
        if self.seconds < 0:
            return f"{found}: it shows what comes, so the joints are stamped late, or by another clock than it is"
        if self.high >= LONGEST_SECONDS:
            return f"{found}; it may be later still, {LONGEST_SECONDS:g} s is the longest that is tried"
        return found


def gauge_lag(recordings: Sequence[Recording], gauge: str, inputs: Sequence[str]) -> Lag | None:
    """The lag of channel `gauge` behind `inputs`, of all recordings together; None where the inputs explain too little
    of it (standing still tells no lag), or nothing moves.

    Raises RecordingError for a channel that is not there or is no single number, for other rates, and for recordings
    that are shorter than five times the longest lag.
    """
    if not recordings:
        raise RecordingError("No recordings to see a lag in. Record or import some first.")
    rate = recordings[0].rate_hz
    longest = round(LONGEST_SECONDS * rate)
    features, targets = [], []
    for one in recordings:
        for name in (gauge, *inputs):
            if name not in one.channels:
                raise RecordingError(f"{one.id or 'A recording'}: " + unknown_name("channel", name, one.channels))
        shown = one.values(gauge)
        if shown.size != one.num_samples:
            raise RecordingError(f"'{gauge}' has shape {shown.shape[1:]} a sample, expected one number.")
        if one.rate_hz != rate:
            raise RecordingError(f"{one.id or 'A recording'}: {one.rate_hz:g} Hz, others have {rate:g} Hz.")
        if one.num_samples >= 5 * longest:
            features.append(_features(one, inputs))
            targets.append(shown.reshape(-1).astype(np.float64))
    if not targets:
        raise RecordingError(
            f"No recording lasts {5 * LONGEST_SECONDS:g} s, which a lag of up to {LONGEST_SECONDS:g} s takes to be "
            "seen."
        )
    lags = np.arange(-longest, longest + 1)
    scores = np.array([_explained(features, targets, lag, longest) for lag in lags.tolist()])
    most, late = float(scores.max()), float(scores[longest:].max())
    if late >= (1 - CLEARLY) * most:  # a steady gait looks alike one stride earlier
        lags, scores, most = lags[longest:], scores[longest:], late
    if not most >= LEAST_R2:
        return None
    near = lags[scores >= most - NEARLY * most]
    at_zero = float(scores[lags == 0][0])
    return Lag(int(lags[np.argmax(scores)]) / rate, int(near[0]) / rate, int(near[-1]) / rate, most, at_zero)


def _features(recording: Recording, inputs: Sequence[str]) -> np.ndarray:
    """(T, F): sums over the components of each input, of its size and square, and of products of two of one shape."""
    values = [recording.values(name).reshape(recording.num_samples, -1).astype(np.float64) for name in inputs]
    columns = []
    for at, one in enumerate(values):
        columns += [one.sum(1), np.abs(one).sum(1), (one**2).sum(1)]
        for other in values[at + 1 :]:
            if other.shape == one.shape:
                columns += [(one * other).sum(1), np.abs(one * other).sum(1)]
    return np.stack(columns, axis=1)


def _explained(features: list[np.ndarray], targets: list[np.ndarray], lag: int, longest: int) -> float:
    """R² of the gauge at t given features at t - lag, over the same samples for every lag from -longest to longest;
    (T - 2 longest) of each."""
    x = np.concatenate([one[longest - lag : len(one) - longest - lag] for one in features])
    y = np.concatenate([one[longest : len(one) - longest] for one in targets])
    spread = x.std(0)
    x = (x - x.mean(0)) / np.where(spread > 0, spread, 1.0)
    y = y - y.mean()
    total = float(y @ y)
    if total <= 0:
        return 0.0
    weights = np.linalg.solve(x.T @ x + RIDGE * len(x) * np.eye(x.shape[1]), x.T @ y)
    return 1.0 - float(((y - x @ weights) ** 2).sum()) / total
