"""Ridge regression from sums of squares and products, and its penalties by cross-validation.

Components of one channel (the joints of a robot) often act alike: what heats one motor heats the next. `pooling` κ lets
them share: of the weights of one feature over the components, the part along their common coefficient is penalised κ
times less than what each has of its own (partial pooling, as in a hierarchical linear model),

    argmin |Xw − y|² + ridge · count · Σ_g |w_g|² − (1 − 1/κ) (a_g · w_g)²        a_g = s_g / |s_g|

with s the standard deviations of the features, since equal coefficients in channel units are weights w ∝ s of z-scored
features. κ = 1 is plain ridge.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from statistics import stdev
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from hts.measurement.split import WHOLE_POLICIES_FROM, left_out_together, same_samples

if TYPE_CHECKING:
    from hts.recordings.recording import Recording

RIDGES = (1e-6, 1e-5, 1e-4, 1e-3, 1e-2, 1e-1, 1.0, 10.0)  # per sample; features have variance 1
POOLINGS = (1.0, 30.0, 1000.0)
MOST_FOLDS = 5
BLOCKS = 10  # of all recordings together, where there are too few to leave out whole ones
LEAST_BLOCK_SECONDS = 2.0


@dataclass(frozen=True)
class Choice:
    """ridge, pooling κ, and how many of the lags are used, the shortest ones; error: mean squared, on what was left
    out."""

    ridge: float
    pooling: float
    lags: int
    error: float


class Moments:
    """XᵀX, Xᵀy and yᵀy of a regression, summed up piece by piece; the last column of X is 1 and not penalised."""

    def __init__(self, width: int) -> None:
        self.count = 0
        self.xx, self.xy = torch.zeros(width, width, dtype=torch.double), torch.zeros(width, dtype=torch.double)
        self.yy, self.y = torch.zeros((), dtype=torch.double), torch.zeros((), dtype=torch.double)

    def add(self, x: Tensor, y: Tensor) -> None:
        self.count += len(y)
        self.xx += x.t() @ x
        self.xy += x.t() @ y
        self.yy += y @ y
        self.y += y.sum()

    def __add__(self, other: Moments) -> Moments:
        both = Moments(len(self.xy))
        both.count = self.count + other.count
        both.xx, both.xy = self.xx + other.xx, self.xy + other.xy
        both.yy, both.y = self.yy + other.yy, self.y + other.y
        return both

    def first(self, columns: int) -> Moments:
        """Of the first so many columns, and the last."""
        kept = torch.cat((torch.arange(columns), torch.tensor([len(self.xy) - 1])))
        part = Moments(0)
        part.count, part.yy, part.y = self.count, self.yy, self.y
        part.xx, part.xy = self.xx[kept][:, kept], self.xy[kept]
        return part

    def solved(self, penalty: Tensor) -> Tensor:
        """argmin |Xw − y|² + count · wᵀ penalty w; penalty: (width, width)."""
        count = max(1, self.count)
        # A trace of it everywhere: a feature that never varied has an empty column.
        matrix = self.xx + count * (penalty + 1e-9 * torch.eye(len(self.xy), dtype=torch.double))
        root, failed = torch.linalg.cholesky_ex(matrix)
        if failed:  # features that say the same thing
            return torch.linalg.solve(matrix, self.xy)
        return torch.cholesky_solve(self.xy[:, None], root)[:, 0]

    def error(self, w: Tensor) -> float:
        """Mean squared error."""
        return float(self.yy - 2 * w @ self.xy + w @ self.xx @ w) / self.count

    def variance(self) -> float:
        return float(self.yy / self.count - (self.y / self.count) ** 2)


def penalty_of(pooling: float, std: Tensor, groups: Sequence[slice], lags: int) -> Tensor:
    """The penalty at ridge 1, (lags · G + 1, lags · G + 1). std: (G,) of the features; groups: places of those that
    may share a coefficient."""
    block = torch.eye(len(std), dtype=torch.double)
    for group in groups:
        along = std[group].double() / std[group].double().norm()
        block[group, group] -= (1.0 - 1.0 / pooling) * torch.outer(along, along)
    whole = torch.zeros(lags * len(std) + 1, lags * len(std) + 1, dtype=torch.double)
    whole[:-1, :-1] = torch.block_diag(*[block] * lags)
    return whole


def spans(lags: int) -> tuple[int, ...]:
    """How many lags are tried: the present sample alone, a quarter, half and all of them."""
    return tuple(sorted({1, 1 + (lags - 1) // 4, 1 + (lags - 1) // 2, lags}))


def chosen(
    folds: Sequence[Moments],
    std: Tensor,
    groups: Sequence[slice],
    lags: int,
    ridges: Sequence[float] = RIDGES,
    poolings: Sequence[float] = POOLINGS,
) -> Choice:
    """The penalties and lags with the least error on what was left out; of ridges that do about as well, the largest.

    About as well: the mean difference over folds is at most its standard error (the one-standard-error rule of
    Breiman et al. 1984, on differences, since folds are hard or easy for all penalties alike). A single fold is
    compared on what it was fitted to. folds: sums over the samples that are left out together, each (lags · G + 1,).
    """
    features = len(std)
    errors: dict[tuple[int, float, float], list[float]] = {}
    weights = [fold.count / sum(one.count for one in folds) for fold in folds]

    def mean(values: Sequence[float]) -> float:
        return sum(weight * value for weight, value in zip(weights, values, strict=True))

    def try_out(count: int, poolings: Sequence[float], ridges: Sequence[float]) -> None:
        parts = [fold.first(count * features) for fold in folds]
        rests = [_all_but(part, parts) for part in parts] if len(parts) > 1 else parts
        for pooling in poolings:
            penalty = penalty_of(pooling, std, groups, count)
            for ridge in ridges:
                pairs = zip(parts, rests, strict=True)
                errors[count, pooling, ridge] = [part.error(rest.solved(ridge * penalty)) for part, rest in pairs]

    for count in spans(lags):
        try_out(count, poolings, ridges[::2])
    span, pooling, _ = min(errors, key=lambda one: mean(errors[one]))
    try_out(span, (pooling,), ridges)
    best = min(errors, key=lambda one: mean(errors[one]))
    largest = best
    for ridge in ridges:
        one = (*best[:2], ridge)
        more = [a - b for a, b in zip(errors[one], errors[best], strict=True)]
        if ridge > largest[2] and len(more) > 1 and mean(more) <= stdev(more) / math.sqrt(len(more)):
            largest = one
    return Choice(largest[2], largest[1], largest[0], mean(errors[largest]))


def parts_left_out(
    recordings: Sequence[Recording], lengths: Sequence[int], rate_hz: float
) -> list[list[tuple[int, int]]]:
    """Of each recording, (stop, fold) of the parts that are left out together: samples up to stop, from the one before.

    Whole policies from four on, whole recordings from five on, and else stretches of at least two seconds. What stands
    several times in the list, as in a bootstrap, counts once and is left out together: its twin knows every sample.
    """
    firsts = same_samples(recordings)
    once = dict(zip(firsts, lengths, strict=True))
    if len({recording.policy_hash for recording in recordings}) >= WHOLE_POLICIES_FROM or len(once) >= 5:
        return [[(n, fold)] for n, fold in zip(lengths, left_out_together(recordings, MOST_FOLDS), strict=True)]
    found, number = {}, itertools.count()
    least = max(1, round(LEAST_BLOCK_SECONDS * rate_hz))
    for first, length in once.items():
        blocks = max(1, min(round(BLOCKS * length / sum(once.values())), length // least))
        stops = [round(length * (index + 1) / blocks) for index in range(blocks)]
        found[first] = [(stop, next(number) % MOST_FOLDS) for stop in stops]
    return [found[first] for first in firsts]


def _all_but(part: Moments, parts: Sequence[Moments]) -> Moments:
    first, *rest = (one for one in parts if one is not part)
    return sum(rest, start=first)
