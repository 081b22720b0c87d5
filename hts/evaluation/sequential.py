"""Looking at a head-to-head as often as one likes: intervals of a mean that hold at every look at once.

A 95 % interval holds at one look that was fixed before. Whoever looks after each block, and stops when the interval
leaves zero, is wrong far more often. A confidence sequence holds the truth at *all* looks, with 95 % together, so the
moment to stop may depend on anything that was seen.

Units are few (a block against its neighbour each) and their variance is unknown, so bounds for bounded or
sub-Gaussian values need a number nobody has, and asymptotic sequences are not yet true. What is exact from the second
unit on, for normal units, is the t-test's likelihood ratio mixed over the effect size δ = (μ − μ₀)/σ ~ N(0, g) with
σ integrated out by its right Haar measure: under μ₀ it is a martingale whatever σ is (Lai 1976, Annals of Statistics
4:265; Hendriksen, de Heide and Grünwald 2021, Bayesian Analysis 16:961; Wang and Ramdas 2025, Sequential Analysis
44:56). By Ville's inequality it exceeds 1/α ever with probability α at most.

`docs/evaluation.md` says what units are, how they are checked, and what it costs.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence

import numpy as np

EFFECT_VARIANCE = 15.0
"""g: variance of the effect size for which intervals are narrow. Any value is honest; this one suits few units."""


def evidence(values: Sequence[float] | np.ndarray, null: float = 0.0, g: float = EFFECT_VARIANCE) -> float:
    """How much more likely `values` are if their mean is not `null`: an e-value, 1 on average if it is.

    values: n independent units. With t = √n (x̄ − μ₀)/s, ν = n − 1 and r = 1/(1 + n g),

        E = √r · [(1 + t²/ν) / (1 + r t²/ν)]^(n/2)

    It may be looked at after each unit: P(ever E ≥ 1/α) ≤ α. One unit says nothing (1). Infinite where it is more than
    a float holds. Raises ValueError for a value that is not finite.
    """
    found = _checked(values)
    n = len(found)
    if n < 2:
        return 1.0
    off, squares = n * (float(found.mean()) - null) ** 2, float(((found - found.mean()) ** 2).sum())
    if squares == 0.0:
        return 1.0 if off == 0.0 else math.inf
    r, ratio = 1.0 / (1.0 + n * g), off / squares  # ratio = t²/ν
    log = 0.5 * math.log(r) + 0.5 * n * (math.log1p(ratio) - math.log1p(r * ratio))
    return math.exp(log) if log < math.log(sys.float_info.max) else math.inf


def half_width(values: Sequence[float] | np.ndarray, error: float = 0.05, g: float = EFFECT_VARIANCE) -> float:
    """Half of the confidence sequence's width after these units: x̄ ± this holds the mean at every look at once.

    error: α, the probability that it ever misses. It is the μ₀ with `evidence` < 1/α: with k = ((1 + n g)/α²)^(1/n),

        t²/ν ≤ (k − 1)/(1 − k r),   infinite as long as k r ≥ 1

    With the default g and α = 0.05 it is finite from the third unit on. Raises ValueError as `evidence`, and for an
    error that is no probability.
    """
    if not 0.0 < error < 1.0:
        raise ValueError(f"error is {error}; expected a probability between 0 and 1")
    found = _checked(values)
    n = len(found)
    if n < 2:
        return math.inf
    grown = 1.0 + n * g
    k = math.exp((math.log(grown) - 2.0 * math.log(error)) / n)
    if k >= grown:
        return math.inf
    squares = float(((found - found.mean()) ** 2).sum())
    return math.sqrt((k - 1.0) / (1.0 - k / grown) * squares / n)


def confidence_sequence(
    values: Sequence[float] | np.ndarray, error: float = 0.05, g: float = EFFECT_VARIANCE
) -> np.ndarray:
    """Interval of the mean after each unit, shape (units, 2), cut with all before it: what was excluded stays so.

    The truth is in all of them with probability 1 − error at least. A row can be empty (lower > upper): then the units
    have no common mean.
    """
    found = _checked(values)
    rows = np.empty((len(found), 2))
    low, high = -math.inf, math.inf
    for count in range(1, len(found) + 1):
        mean, width = float(found[:count].mean()), half_width(found[:count], error, g)
        low, high = max(low, mean - width), min(high, mean + width)
        rows[count - 1] = low, high
    return rows


def batch_means(series: np.ndarray, length: int) -> np.ndarray:
    """Means of contiguous stretches of `length` segments of one uninterrupted series, shape (len(series) // length,).

    Neighbouring segments are alike, means of long enough stretches hardly (Flegal and Jones 2010): these are units.
    A shorter rest is left out. Raises ValueError for a length below 1.
    """
    if length < 1:
        raise ValueError(f"length is {length} segments; expected at least 1")
    count = len(series) // length
    return _checked(series)[: count * length].reshape(count, length).mean(axis=1)


def _checked(values: Sequence[float] | np.ndarray) -> np.ndarray:
    found = np.asarray(values, dtype=float)
    if found.ndim != 1:
        raise ValueError(f"units have shape {found.shape}; expected one number each")
    if not np.isfinite(found).all():
        raise ValueError(f"{int((~np.isfinite(found)).sum())} of {len(found)} units are not finite numbers")
    return found
