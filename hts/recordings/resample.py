"""From irregular time stamps to an even grid."""

from __future__ import annotations

import numpy as np


def interpolate(times: np.ndarray, values: np.ndarray, grid: np.ndarray) -> np.ndarray:
    """Values at the instants of `grid`, by straight lines between samples.

    times: (rows,) s, increasing; values: (rows, k); grid: (T,) s within the times. Returns (T, k).
    """
    return np.stack([np.interp(grid, times, column) for column in values.T], axis=1)


def hold(times: np.ndarray, values: np.ndarray, grid: np.ndarray, slack: float = 0.0) -> np.ndarray:
    """The last value at or before each instant, as a logger writes that repeats what a slow gauge shows.

    Shapes as in `interpolate`; slack: s, by so much an instant may lie before a sample and still be at it. Before the
    first sample it is the first.
    """
    last = np.searchsorted(times, grid + slack, side="right") - 1
    return values[np.clip(last, 0, len(times) - 1)]


def window_mean(times: np.ndarray, values: np.ndarray, grid: np.ndarray, width: float) -> np.ndarray:
    """Mean of the straight lines between samples over [t - width/2, t + width/2], cut at the ends of the log.

    Shapes as in `interpolate`; width: s. A centred mean has no lag, and keeps what lies above half the new rate
    from folding down into it.
    """
    low = np.maximum(grid - width / 2, times[0])
    high = np.minimum(grid + width / 2, times[-1])
    return (_integral(times, values, high) - _integral(times, values, low)) / (high - low)[:, None]


def _integral(times: np.ndarray, values: np.ndarray, until: np.ndarray) -> np.ndarray:
    """Integral of the straight lines from times[0] to `until`, (T, k): exact, as a parabola within each piece."""
    steps = np.diff(times)[:, None]
    whole = np.concatenate([np.zeros((1, values.shape[1])), np.cumsum(steps * (values[1:] + values[:-1]) / 2, axis=0)])
    piece = np.clip(np.searchsorted(times, until, side="right") - 1, 0, len(times) - 2)
    part = (until - times[piece])[:, None]
    slope = (values[piece + 1] - values[piece]) / steps[piece]
    return whole[piece] + values[piece] * part + slope * part**2 / 2
