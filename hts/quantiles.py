"""Quantiles of the distributions that intervals are made of.

From `scipy.special`: `scipy.stats` gives the same numbers and takes 0.4 s to import, which each run would pay.
"""

from __future__ import annotations


def normal_quantile(probability: float) -> float:
    """The standard normal's: 1.96 for 0.975."""
    from scipy.special import ndtri

    return float(ndtri(probability))


def student_quantile(probability: float, degrees: float) -> float:
    """Student's t with so many degrees of freedom: 2.228 for 0.975 and 10."""
    from scipy.special import stdtrit

    return float(stdtrit(degrees, probability))
