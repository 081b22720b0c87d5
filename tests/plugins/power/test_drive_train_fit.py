"""Weights of the drives' terms: the constrained least squares they come from."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from hts_power.drive_train_fit import IDLE_SHARE, TERMS, Drives, Sums

KIND = np.array([0, 1, 0, 1])
COMMON, OWN, REST = 1e-3, 100.0, -1.7


def problem(seed: int, truth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Terms (T, TERMS · J) of which some are nearly the same, and a target with noise."""
    rng = np.random.default_rng(seed)
    terms = np.abs(rng.normal(size=(400, TERMS * len(KIND))))
    terms[:, -len(KIND) :] = terms[:, : len(KIND)] ** 2 + 0.05 * rng.normal(size=(400, len(KIND)))
    return terms, terms @ truth - 2.0 + 0.3 * rng.normal(size=400)


EXPECTED = np.repeat([0.6, 0.2, 0.2, 0.0, 0.0, 0.0, 0.0], len(KIND))  # p: copper loss and mechanical power


@pytest.mark.parametrize("expected", [None, EXPECTED])
@pytest.mark.parametrize("rest", [None, REST])
def test_it_is_the_least_squares_solution_with_weights_that_are_not_negative(
    rest: float | None, expected: np.ndarray | None
) -> None:
    truth = np.random.default_rng(7).normal(0.0, 0.4, TERMS * len(KIND))  # half of it is what no drive does
    terms, target = problem(1, truth)
    drives = Drives(KIND, rest, expected)
    found = drives._solved(Sums.of(terms, target, 0), COMMON, OWN)

    # The same written out: rows for samples, for w - s p - A u, for u, and for the level at rest; u, s, level are free.
    n, size, joints = len(target), terms.shape[1], len(KIND)
    spread = np.zeros((size, 2 * TERMS))
    for term in range(TERMS):
        for joint, kind in enumerate(KIND):
            spread[term * joints + joint, 2 * term + kind] = 1.0
    common, factor = spread.shape[1], (np.zeros(size) if expected is None else expected)[:, None]
    rows = [
        np.concatenate((terms, np.zeros((n, common + 1)), np.ones((n, 1))), 1),
        np.sqrt(COMMON * OWN * n) * np.concatenate((np.eye(size), -spread, -factor, np.zeros((size, 1))), 1),
        np.sqrt(COMMON * n) * np.concatenate((np.zeros((common, size)), np.eye(common), np.zeros((common, 2))), 1),
    ]
    right = [target, np.zeros(size + common)]
    if rest is not None:
        rows.append(np.sqrt(IDLE_SHARE * n) * np.eye(1, size + common + 2, size + common + 1))
        right.append(np.array([np.sqrt(IDLE_SHARE * n) * rest]))
    low = np.concatenate((np.zeros(size), np.full(common + 2, -np.inf)))
    solution = lsq_linear(np.concatenate(rows), np.concatenate(right), (low, np.inf), method="bvls", tol=1e-14).x
    np.testing.assert_allclose(found, np.append(solution[:size], solution[-1]), atol=1e-5)
    assert (found[:-1] == 0).sum() > 3 and (found[:-1] >= 0).all()


def test_without_anything_to_forbid_it_is_ordinary_ridge_regression() -> None:
    terms, target = problem(2, np.full(TERMS * len(KIND), 0.5))
    drives = Drives(KIND, REST)
    sums = Sums.of(terms, target, 0)
    found = drives._solved(sums, 1e-6, 10.0)
    right = sums.xy.copy()
    right[-1] += IDLE_SHARE * sums.count * REST
    np.testing.assert_allclose(found, np.linalg.solve(drives._normal(sums, 1e-6, 10.0), right), atol=1e-4)
    assert (found[:-1] > 0).all()


def test_data_that_say_nothing_leave_what_is_expected_and_data_that_do_overrule_it() -> None:
    """Few samples in much noise: the weights are the expected ones times what the data say of their sum."""
    rng = np.random.default_rng(5)
    truth = np.repeat([0.1, 0.5, 0.0, 0.3, 0.0, 0.0, 0.0], len(KIND))

    def fitted(samples: int, noise: float) -> np.ndarray:
        terms = np.abs(rng.normal(size=(samples, TERMS * len(KIND))))
        target = terms @ truth + noise * rng.normal(size=samples)
        drives, parts = Drives(KIND, None, EXPECTED), 3
        drives.fit(np.array_split(terms, parts), np.array_split(target, parts), np.arange(parts), 0)
        return drives.weight

    few, many = fitted(60, 3.0), fitted(3000, 0.1)
    factor = few @ EXPECTED / (EXPECTED @ EXPECTED)
    assert factor > 0.2 and np.abs(few - factor * EXPECTED).max() < 0.2 * factor
    np.testing.assert_allclose(many, truth, atol=0.03)


def test_what_few_gaits_suggest_is_no_gift() -> None:
    """Two gaits in which hard pushes happen to come with a low level: no weight may call them a gain."""
    rng = np.random.default_rng(3)
    terms = np.abs(rng.normal(size=(600, TERMS * len(KIND))))
    target = terms[:, : len(KIND)].sum(1) + 0.1 * rng.normal(size=600)
    target -= 0.8 * terms[:, -len(KIND) :].sum(1)
    drives = Drives(KIND, None)
    drives.fit([terms[:300], terms[300:]], [target[:300], target[300:]], np.array([0, 1]), 0)
    assert (drives.weight >= 0).all()
    assert drives.weight[-len(KIND) :].max() < 0.02  # and what is left of them is nothing
