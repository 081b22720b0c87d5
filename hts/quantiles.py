"""Quantiles, of weighted values and of the distributions that intervals are made of.

Those of distributions are from `scipy.special`: `scipy.stats` gives the same numbers and takes 0.4 s to import, which
each run would pay.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np


def weighted_quantiles(values: np.ndarray, shares: np.ndarray, probabilities: Sequence[float]) -> np.ndarray:
    """Of values (N,) with shares (N,) that sum to 1: where the cumulated share, from the middle of each, passes the
    probability."""
    order = np.argsort(values)
    reached = np.cumsum(shares[order]) - shares[order] / 2
    return np.interp(probabilities, reached, values[order])


def normal_quantile(probability: float) -> float:
    """The standard normal's: 1.96 for 0.975."""
    from scipy.special import ndtri

    return float(ndtri(probability))


def student_quantile(probability: float, degrees: float) -> float:
    """Student's t with so many degrees of freedom: 2.228 for 0.975 and 10."""
    from scipy.special import stdtrit

    return float(stdtrit(degrees, probability))
