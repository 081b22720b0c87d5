"""Weights of the drives' terms by regularised least squares; see `hts_power.drive_train_model`."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from hts_power.drive_train_prior import Expected

DIRECTIONS = 16  # of the posterior covariance that are kept, the widest ones
IDLE_SHARE = 0.02  # the idle level counts as so many samples, of all
BLOCK_SECONDS = 2.0  # of residuals that are taken to be one: a stride is like the next
ROUNDS = 4  # of weights and noise in turn
LEAST_FACTOR = 1e-3  # of the target's standard deviation: what the expected power explains at least


def skipped(length: int, longest: int) -> int:
    """How much of a recording's start is not used: what came before it is unknown."""
    return min(longest, length // 2)


class Drives:
    """Weights w of the drives' terms and the level b: the most probable ones given what is expected of them.

    w = s (m + d), d normal with mean 0 and covariance C, m and C from `drive_train_prior`; the factor s is free. The
    residuals are normal with a variance that the data say; so the penalty needs no choice, and the posterior
    covariance is that of the fit. Everything follows from sums of squares and products of each recording.

    rest: the level that idle says, in units of the target, or None.
    """

    def __init__(self, expected: Expected, rest: float | None) -> None:
        self._rest, self._mean = rest, expected.weight
        precision = np.linalg.inv(expected.covariance)
        pulled = precision @ self._mean
        certainty = float(self._mean @ pulled)
        self._along = pulled / certainty  # w to s
        self._pull = precision - np.outer(pulled, pulled) / certainty  # what is left when the best s is put in
        self.weight, self.bias, self.error = np.zeros(len(self._mean)), 0.0, math.inf
        self.noise, self.factor = math.nan, math.nan

    def fit(
        self,
        shown: Sequence[np.ndarray],
        targets: Sequence[np.ndarray],
        new: Sequence[np.ndarray],
        folds: np.ndarray,
        block: int,
        longest: int,
    ) -> None:
        """shown: terms as the sensor shows them, (T, TERMS · J) of each recording; targets: (T,); new: whether a sample
        is a reading, (T,); folds: a number of each recording; block: samples whose residuals are taken to be one."""
        logs = list(zip(shown, targets, new, strict=True))
        parts = [Sums.of(*log, longest) for log in logs]
        whole = Sums.total(parts)
        if math.isnan(self.noise):
            spread = whole.yy / whole.count - (whole.xy[-1] / whole.count) ** 2
            self.noise, self.factor = spread, math.sqrt(spread) / self._size(whole)
        for _ in range(ROUNDS):
            solution = self._solved(whole)
            self.weight, self.bias = solution[:-1], float(solution[-1])
            self.factor = max(
                float(self._along @ self.weight), LEAST_FACTOR * math.sqrt(whole.yy / whole.count) / self._size(whole)
            )
            self.noise = self._variance(logs, block, longest)
        own = [Sums.total([one for one, at in zip(parts, folds, strict=True) if at == fold]) for fold in set(folds)]
        rests = [(part, whole.minus(part)) for part in own] if len(own) > 1 else [(whole, whole)]
        self.error = float(np.mean([part.error(self._solved(rest)) for part, rest in rests if part.count]))

    def doubt(
        self, shown: Sequence[np.ndarray], targets: Sequence[np.ndarray], new: Sequence[np.ndarray], longest: int
    ) -> np.ndarray:
        """Square root (TERMS · J + 1, DIRECTIONS) of the posterior covariance of weights and level."""
        whole = Sums.total([Sums.of(*log, longest) for log in zip(shown, targets, new, strict=True)])
        covariance = np.linalg.inv(self._normal(whole)) * self.noise
        values, vectors = np.linalg.eigh((covariance + covariance.T) / 2)
        kept = np.argsort(values)[::-1][:DIRECTIONS]
        root = np.zeros((len(values), DIRECTIONS))  # of a robot with fewer, the rest stays 0
        root[:, : len(kept)] = vectors[:, kept] * np.sqrt(np.maximum(values[kept], 0.0))
        return root

    def _variance(self, logs: Sequence[tuple[np.ndarray, np.ndarray, np.ndarray]], block: int, longest: int) -> float:
        """Of residuals, as if each reading had its own: they are alike for a while, and one recording's differ from the
        next one's. The variance of their means over blocks, and over recordings, times the count says how many
        readings are really one."""
        whole, pieces = [], []
        for terms, target, new in logs:
            skip = skipped(len(target), longest)
            residual, read = (target - terms @ self.weight - self.bias)[skip:], new[skip:]
            whole.append(residual[read])
            starts = range(0, max(1, len(read) - block + 1), block)
            pieces += [residual[i : i + block][read[i : i + block]] for i in starts]

        def of_means(groups: Sequence[np.ndarray]) -> float:
            return float(np.mean([len(group) * group.mean() ** 2 for group in groups if len(group)]))

        return max(of_means(pieces), of_means(whole), float(np.mean(np.concatenate(whole) ** 2)))

    def _size(self, sums: Sums) -> float:
        """Standard deviation of the expected power, in the unit of the prior."""
        mean = float(self._mean @ sums.xx[:-1, -1]) / sums.count
        square = float(self._mean @ sums.xx[:-1, :-1] @ self._mean) / sums.count
        return math.sqrt(max(square - mean * mean, 1e-12 * max(square, 1e-12)))

    def _solved(self, sums: Sums) -> np.ndarray:
        """(w, b) with w >= 0: no drive gives back what it lost.

        The level follows from w, so that non-negative least squares in w alone is left: what remains of the normal
        equations of (w, b) when b is eliminated (their Schur complement).
        """
        matrix, right = self._normal(sums), sums.xy[:-1].copy()
        weight_of_level, level = self._level(sums)
        cross = sums.xx[:-1, -1]
        right -= cross * level / weight_of_level
        weight = _non_negative(matrix[:-1, :-1] - np.outer(cross, cross) / weight_of_level, right)
        return np.append(weight, (level - cross @ weight) / weight_of_level)

    def _level(self, sums: Sums) -> tuple[float, float]:
        """Diagonal element and right side of the normal equation of b, with what the idle level says of it."""
        if self._rest is None:
            return sums.count * (1.0 + 1e-9), float(sums.xy[-1])
        return sums.count * (1.0 + IDLE_SHARE), float(sums.xy[-1]) + IDLE_SHARE * sums.count * self._rest

    def _normal(self, sums: Sums) -> np.ndarray:
        """Matrix of the normal equations of (w, b), without the constraint."""
        matrix = sums.xx.copy()
        matrix[:-1, :-1] += self.noise / self.factor**2 * self._pull
        matrix[-1, -1] = self._level(sums)[0]
        return matrix


def _non_negative(gram: np.ndarray, right: np.ndarray) -> np.ndarray:
    """argmin over w >= 0 of wᵀ G w / 2 - rightᵀ w, G positive definite but for rounding."""
    from scipy.optimize import nnls  # 0.4 s, which no process that fits nothing need pay

    gram = (gram + gram.T) / 2
    gram[np.diag_indices_from(gram)] += 1e-12 * np.trace(gram) / len(gram)
    root = np.linalg.cholesky(gram)
    return nnls(root.T, np.linalg.solve(root, right), maxiter=50 * len(right))[0]


class Sums:
    """XᵀX, Xᵀy, yᵀy of (terms, 1) and target, over readings."""

    def __init__(self, count: int, xx: np.ndarray, xy: np.ndarray, yy: float) -> None:
        self.count, self.xx, self.xy, self.yy = count, xx, xy, yy

    @classmethod
    def of(cls, terms: np.ndarray, target: np.ndarray, new: np.ndarray, longest: int) -> Sums:
        skip = skipped(len(target), longest)
        read = np.flatnonzero(new[skip:]) + skip
        x, y = np.concatenate((terms[read], np.ones((len(read), 1))), 1), target[read]
        return cls(len(y), x.T @ x, x.T @ y, float(y @ y))

    @classmethod
    def total(cls, sums: Sequence[Sums]) -> Sums:
        none = np.zeros(())
        xx, xy = sum((s.xx for s in sums), none), sum((s.xy for s in sums), none)
        return cls(sum(s.count for s in sums), xx, xy, sum(s.yy for s in sums))

    def minus(self, other: Sums) -> Sums:
        return Sums(self.count - other.count, self.xx - other.xx, self.xy - other.xy, self.yy - other.yy)

    def error(self, solution: np.ndarray) -> float:
        """Mean squared error of (w, b)."""
        return float(self.yy - 2 * solution @ self.xy + solution @ self.xx @ solution) / max(1, self.count)
