"""Weights of the drives' terms by hierarchical least squares; see `hts_power.drive_train_model`."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

import numpy as np
from scipy.optimize import nnls

COMMON = (1e-6, 1e-5, 1e-4, 1e-3, 1e-2)  # penalty on common weights, per sample
STRONGER = (1e-1, 1.0, 10.0)  # besides, where it draws to weights that are expected and not to none
OWN = (10.0, 100.0, 1000.0, 1e5)  # times that: on deviations of single joints
DIRECTIONS = 16  # of the posterior covariance that are kept, the widest ones
IDLE_SHARE = 0.02  # the idle level counts as so many samples, of all
BLOCK_SECONDS = 2.0  # of residuals that are taken to be one: a stride is like the next
TERMS = 7  # per joint


def skipped(length: int, longest: int) -> int:
    """How much of a recording's start is not used: what came before it is unknown."""
    return min(longest, length // 2)


class Drives:
    """Weights of the drives' terms by hierarchical least squares.

    Coefficients are common ones of each kind of joint (u), deviations of each joint (v), and the level b:
    w = s p + A u + v. Everything follows from sums of squares and products of each recording.

    kind: of each joint, (J,); rest: the level that idle says, in units of the target, or None; expected: p,
    (TERMS · J,), weights that are expected up to one factor s, which is free; None: weights are drawn to nothing.
    """

    def __init__(self, kind: np.ndarray, rest: float | None, expected: np.ndarray | None = None) -> None:
        joints, number = len(kind), int(kind.max()) + 1
        self._rest, self._expected = rest, expected
        size = TERMS * joints
        self._spread = np.zeros((size, TERMS * number))  # A
        for term in range(TERMS):
            for joint in range(joints):
                self._spread[term * joints + joint, term * number + kind[joint]] = 1.0
        self.weight, self.bias, self.error = np.zeros(size), 0.0, math.inf
        self.penalties = (COMMON[0], OWN[0])

    def fit(
        self,
        shown: Sequence[np.ndarray],
        targets: Sequence[np.ndarray],
        folds: np.ndarray,
        longest: int,
        choose: bool = True,
    ) -> None:
        """shown: terms as the sensor shows them, (T, TERMS · J) of each recording; folds: a number of each; choose:
        choose the penalties, which takes most of the time, or keep those of the last fit."""
        sums = [Sums.of(terms, target, longest) for terms, target in zip(shown, targets, strict=True)]
        whole = Sums.total(sums)
        if choose:
            self._choose(sums, whole, folds)
        solution = self._solved(whole, *self.penalties)
        self.weight, self.bias = solution[:-1], float(solution[-1])

    def _choose(self, sums: Sequence[Sums], whole: Sums, folds: np.ndarray) -> None:
        """The penalties: the largest within one standard error of the best on left-out folds."""
        parts = [Sums.total([one for one, own in zip(sums, folds, strict=True) if own == fold]) for fold in set(folds)]
        table: dict[tuple[float, float], np.ndarray] = {}
        common = COMMON if self._expected is None else (*COMMON, *STRONGER)
        for penalties in itertools.product(common, OWN):
            rests = [(part, whole.minus(part)) for part in parts] if len(parts) > 1 else [(whole, whole)]
            table[penalties] = np.array([part.error(self._solved(rest, *penalties)) for part, rest in rests])
        best = min(table, key=lambda one: table[one].mean())
        bar = table[best].mean() + table[best].std(ddof=min(1, len(table[best]) - 1)) / math.sqrt(len(table[best]))
        # Those of deviations first: single joints are where a model of a few gaits goes wrong.
        self.penalties = max((one for one in table if table[one].mean() <= bar), key=lambda one: (one[1], one[0]))
        self.error = float(table[self.penalties].mean())

    def doubt(
        self, shown: Sequence[np.ndarray], targets: Sequence[np.ndarray], longest: int, rate_hz: float
    ) -> np.ndarray:
        """Square root (TERMS · J + 1, DIRECTIONS) of the posterior covariance of weights and level.

        Residuals are alike for a while, and one recording's differ from the next one's: the variance of their means
        over blocks, and over recordings, times the length says how many samples are really one.
        """
        whole = Sums.total([Sums.of(terms, target, longest) for terms, target in zip(shown, targets, strict=True)])
        residuals = []
        for terms, target in zip(shown, targets, strict=True):
            skip = skipped(len(target), longest)
            residuals.append((target - terms @ self.weight - self.bias)[skip:])
        block = max(1, round(BLOCK_SECONDS * rate_hz))
        pieces = [r[i : i + block] for r in residuals for i in range(0, max(1, len(r) - block + 1), block)]
        noise = max(
            float(np.mean([len(piece) * piece.mean() ** 2 for piece in pieces])),
            float(np.mean([len(piece) * piece.mean() ** 2 for piece in residuals])),
            float(np.mean(np.concatenate(residuals) ** 2)),
        )
        covariance = np.linalg.inv(self._normal(whole, *self.penalties)) * noise
        values, vectors = np.linalg.eigh((covariance + covariance.T) / 2)
        kept = np.argsort(values)[::-1][:DIRECTIONS]
        root = np.zeros((len(values), DIRECTIONS))  # of a robot with fewer, the rest stays 0
        root[:, : len(kept)] = vectors[:, kept] * np.sqrt(np.maximum(values[kept], 0.0))
        return root

    def _solved(self, sums: Sums, common: float, own: float) -> np.ndarray:
        """(w, b) with w >= 0: no drive gives back what it lost.

        The level follows from w, so that non-negative least squares in w alone is left: what remains of the normal
        equations of (w, b) when b is eliminated (their Schur complement).
        """
        matrix, right = self._normal(sums, common, own), sums.xy[:-1].copy()
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

    def _normal(self, sums: Sums, common: float, own: float) -> np.ndarray:
        """Matrix of the normal equations of (w, b), without the constraint."""
        matrix = sums.xx.copy()
        matrix[:-1, :-1] += sums.count * self._penalty(common, own)
        matrix[-1, -1] = self._level(sums)[0]
        return matrix

    def _penalty(self, common: float, own: float) -> np.ndarray:
        """P of wᵀ P w = min over u and s of common |u|² + common own |w - s p - A u|²: what is left of a ridge when the
        best u and s for w are put in."""
        shared = own * self._spread.sum(0)
        penalty = -common * own * (self._spread * (own / (1.0 + shared))) @ self._spread.T
        penalty[np.diag_indices_from(penalty)] += common * own
        if self._expected is not None:
            pulled = penalty @ self._expected
            penalty -= np.outer(pulled, pulled) / (self._expected @ pulled)
        return penalty


def _non_negative(gram: np.ndarray, right: np.ndarray) -> np.ndarray:
    """argmin over w >= 0 of wᵀ G w / 2 - rightᵀ w, G positive definite but for rounding."""
    gram = (gram + gram.T) / 2
    gram[np.diag_indices_from(gram)] += 1e-12 * np.trace(gram) / len(gram)
    root = np.linalg.cholesky(gram)
    return nnls(root.T, np.linalg.solve(root, right), maxiter=50 * len(right))[0]


class Sums:
    """XᵀX, Xᵀy, yᵀy of (terms, 1) and target."""

    def __init__(self, count: int, xx: np.ndarray, xy: np.ndarray, yy: float) -> None:
        self.count, self.xx, self.xy, self.yy = count, xx, xy, yy

    @classmethod
    def of(cls, terms: np.ndarray, target: np.ndarray, longest: int) -> Sums:
        skip = skipped(len(target), longest)
        x, y = np.concatenate((terms[skip:], np.ones((len(terms) - skip, 1))), 1), target[skip:]
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
