"""How far two clocks are apart, from a signal that both logs hold.

The offset is where the correlation of the two signals is largest. It is trusted where that correlation is high and no
other offset does nearly as well: a steady gait looks the same one stride later.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hts.errors import RecordingError
from hts.recordings.resample import interpolate

LEAST_CORRELATION = 0.7
RIVAL = 0.97
"""A second offset whose correlation reaches this share of the best one's makes the answer ambiguous."""
LEAST_OVERLAP = 0.5
"""Of the shorter log: less of it proves nothing."""
MOST_SAMPLES = 2_000_000


@dataclass(frozen=True)
class ClockOffset:
    """seconds: to be added to the second log's times; correlation: there; rival: the best elsewhere;
    drift_seconds: how much further apart the clocks are at the end than at the beginning, NaN for a short log."""

    seconds: float
    correlation: float
    rival: float
    drift_seconds: float

    def __str__(self) -> str:
        text = f"{self.seconds:+.4f} s (correlation {self.correlation:.3f}, elsewhere at most {self.rival:.3f}"
        return text + (f", drift {1000 * self.drift_seconds:+.1f} ms)" if np.isfinite(self.drift_seconds) else ")")


def clock_offset(
    times: np.ndarray, values: np.ndarray, other_times: np.ndarray, other_values: np.ndarray, rate_hz: float
) -> ClockOffset:
    """What to add to `other_times` so that both count one clock.

    times: (rows,) s, increasing; values: (rows, k); the same of the other log, of other lengths. Where both have k
    components each is compared with its own, otherwise their norms. rate_hz: at which both are compared; the offset is
    found to a fraction of its period. Raises RecordingError, without a file's name, where no offset is trustworthy.
    """
    first, second = _comparable(values, other_values)
    a = _even(times, first, rate_hz)
    b = _even(other_times, second, rate_hz)
    lags, scores = _scores(a, b)
    at = int(np.argmax(scores))
    best = float(scores[at])
    width = _half_width(scores, at)
    elsewhere = np.concatenate([scores[: max(at - width, 0)], scores[at + width + 1 :]])
    rival = float(elsewhere.max(initial=-1.0))
    if not best >= LEAST_CORRELATION:
        raise RecordingError(
            f"no offset of the clocks makes the two signals alike (the best correlation is {best:.2f}, expected "
            f"{LEAST_CORRELATION:g} or more). Name the same quantity in both, with its sign and joint order."
        )
    if rival > RIVAL * best:
        other = lags[int(np.argmax(np.where(np.abs(np.arange(len(scores)) - at) > width, scores, -1)))]
        raise RecordingError(
            f"two offsets of the clocks fit nearly equally well (correlation {best:.3f} and {rival:.3f}, "
            f"{abs(other - lags[at]) / rate_hz:.2f} s apart), as in a steady gait. Include a start, a stop or a knock "
            "in both logs, or name another signal."
        )
    begin = float(times[0]) - float(other_times[0])
    offset = begin + (lags[at] + _vertex(scores, at)) / rate_hz
    return ClockOffset(offset, best, rival, _drift(a, b, int(lags[at]), rate_hz))


def _comparable(values: np.ndarray, others: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    if values.shape[1] == others.shape[1]:
        return values, others
    return tuple(np.linalg.norm(one, axis=1, keepdims=True) for one in (values, others))  # type: ignore[return-value]


def _even(times: np.ndarray, values: np.ndarray, rate_hz: float) -> np.ndarray:
    count = int((times[-1] - times[0]) * rate_hz) + 1
    if not 8 <= count <= MOST_SAMPLES:
        raise RecordingError(
            f"a log of {times[-1] - times[0]:.4g} s cannot be compared at {rate_hz:g} Hz. Correct the unit of the "
            "stamps."
        )
    grid = times[0] + np.arange(count) / rate_hz
    even = interpolate(times, values, grid)
    return even - even.mean(axis=0)


def _scores(a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pearson's correlation over the common stretch for every lag of b behind a's beginning, in samples; -1 where that
    stretch is too short.

    Each stretch has means of its own: with those of the whole logs a signal that settles at several levels is most
    alike at a wrong lag. Components are compared together: covariances and variances are summed over them.
    """
    from scipy.signal import correlate

    lags = np.arange(-(len(b) - 1), len(a))
    in_a = np.maximum(lags, 0), np.minimum(lags + len(b), len(a))
    in_b = np.maximum(-lags, 0), np.minimum(len(a) - lags, len(b))
    count = in_a[1] - in_a[0]
    together, square_a, square_b = np.zeros(len(lags)), np.zeros(len(lags)), np.zeros(len(lags))
    for x, y in zip(a.T, b.T, strict=True):
        sum_x, sum_y = _sums(x, *in_a), _sums(y, *in_b)
        together += correlate(x, y, method="fft") - sum_x * sum_y / count
        square_a += _sums(x**2, *in_a) - sum_x**2 / count
        square_b += _sums(y**2, *in_b) - sum_y**2 / count
    floor = 1e-9 * max(float((a**2).sum()), float((b**2).sum()), 1e-30)
    scores = together / np.sqrt(np.maximum(square_a, floor) * np.maximum(square_b, floor))
    scores = np.where(count >= LEAST_OVERLAP * min(len(a), len(b)), scores, -1.0)
    return lags, np.clip(scores, -1.0, 1.0)


def _sums(x: np.ndarray, begin: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Of x over each stretch from begin to before end."""
    total = np.concatenate([[0.0], np.cumsum(x)])
    return total[end] - total[begin]


def _half_width(scores: np.ndarray, at: int) -> int:
    """Samples from the peak to where the correlation has fallen to half of it, on the wider side."""
    low = scores < 0.5 * scores[at]
    right = np.flatnonzero(low[at:])
    left = np.flatnonzero(low[: at + 1][::-1])
    return int(max(right[0] if len(right) else len(scores), left[0] if len(left) else len(scores)))


def _vertex(scores: np.ndarray, at: int) -> float:
    """Where between its neighbours the top of the parabola through the peak lies, in samples."""
    if not 0 < at < len(scores) - 1:
        return 0.0
    before, here, after = scores[at - 1 : at + 2]
    bend = before - 2 * here + after
    return float(np.clip(0.5 * (before - after) / bend, -0.5, 0.5)) if bend < 0 else 0.0


def _drift(a: np.ndarray, b: np.ndarray, lag: int, rate_hz: float) -> float:
    """The offset of the last third less that of the first, s."""
    first, last = max(lag, 0), min(len(a), len(b) + lag)
    third = (last - first) // 3
    reach = min(int(0.2 * rate_hz) + 1, third // 4)
    if third < 5 * rate_hz or reach < 1:
        return float("nan")
    found = []
    for begin in (first, last - third):
        scores = []
        for shift in range(-reach, reach + 1):
            low = max(begin + reach, 0)
            x = a[low : begin + third - reach]
            y = b[low - lag - shift : begin + third - reach - lag - shift]
            if len(x) != len(y):
                return float("nan")
            x, y = x - x.mean(axis=0), y - y.mean(axis=0)
            scores.append(float((x * y).sum() / np.sqrt((x**2).sum() * (y**2).sum() + 1e-30)))
        at = int(np.argmax(scores))
        found.append((at - reach + _vertex(np.array(scores), at)) / rate_hz)
    return found[1] - found[0]
