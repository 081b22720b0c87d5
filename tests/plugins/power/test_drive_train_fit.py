"""Weights of the drives' terms: the constrained least squares they come from, and what is expected of them."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from hts_power.drive_train_fit import IDLE_SHARE, Drives, Sums
from hts_power.drive_train_prior import TERMS, Expected, expected

KIND = np.array([0, 1, 0, 1])
REST = -1.7
SIZE = TERMS * len(KIND)
MEAN = np.repeat([0.6, 0.2, 0.2, 0.0, 0.0, 0.0, 0.0], len(KIND))


def problem(seed: int, truth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Terms (T, TERMS · J) of which some are nearly the same, and a target with noise."""
    rng = np.random.default_rng(seed)
    terms = np.abs(rng.normal(size=(400, SIZE)))
    terms[:, -len(KIND) :] = terms[:, : len(KIND)] ** 2 + 0.05 * rng.normal(size=(400, len(KIND)))
    return terms, terms @ truth - 2.0 + 0.3 * rng.normal(size=400)


def every(terms: np.ndarray) -> np.ndarray:
    return np.ones(len(terms), dtype=bool)


def drawn(seed: int) -> Expected:
    root = np.random.default_rng(seed).normal(size=(SIZE, SIZE)) / np.sqrt(SIZE)
    return Expected(MEAN, root @ root.T + 0.1 * np.eye(SIZE))


def fitted(prior: Expected, terms: np.ndarray, target: np.ndarray, parts: int = 3, rest: float | None = None) -> Drives:
    drives = Drives(prior, rest)
    pieces = np.array_split(terms, parts)
    drives.fit(pieces, np.array_split(target, parts), [every(p) for p in pieces], np.arange(parts), 20, 0)
    return drives


@pytest.mark.parametrize("rest", [None, REST])
def test_it_is_the_most_probable_solution_with_weights_that_are_not_negative(rest: float | None) -> None:
    truth = np.random.default_rng(7).normal(0.0, 0.4, SIZE)  # half of it is what no drive does
    terms, target = problem(1, truth)
    prior = drawn(2)
    drives = Drives(prior, rest)
    drives.noise, drives.factor = 0.09, 0.8
    found = drives._solved(Sums.of(terms, target, every(terms), 0))

    # The same written out: rows for samples, for w - s m in the prior's own unit, and for the level; s and b are free.
    n = len(target)
    root = np.linalg.cholesky(np.linalg.inv(prior.covariance)).T * np.sqrt(0.09) / 0.8
    rows = [
        np.concatenate((terms, np.zeros((n, 1)), np.ones((n, 1))), 1),
        np.concatenate((root, -(root @ prior.weight)[:, None], np.zeros((SIZE, 1))), 1),
    ]
    right = [target, np.zeros(SIZE)]
    if rest is not None:
        rows.append(np.sqrt(IDLE_SHARE * n) * np.eye(1, SIZE + 2, SIZE + 1))
        right.append(np.array([np.sqrt(IDLE_SHARE * n) * rest]))
    low = np.concatenate((np.zeros(SIZE), np.full(2, -np.inf)))
    solution = lsq_linear(np.concatenate(rows), np.concatenate(right), (low, np.inf), method="bvls", tol=1e-14).x
    np.testing.assert_allclose(found, np.append(solution[:SIZE], solution[-1]), atol=1e-5)
    assert (found[:-1] == 0).sum() > 3 and (found[:-1] >= 0).all()


def test_data_that_say_nothing_leave_what_is_expected_and_data_that_do_overrule_it() -> None:
    """Few samples in much noise: the weights are the expected ones times what the data say of their sum."""
    rng = np.random.default_rng(5)
    prior = expected(KIND, np.ones(SIZE), 0.3)
    truth = 2.0 * np.repeat([0.2, 0.9, 0.1, 0.02, 0.01, 0.0, 0.01], len(KIND))
    truth[: len(KIND)] *= np.where(KIND == 0, 1.5, 0.5)  # another gear

    def weights(samples: int, noise: float) -> np.ndarray:
        terms = np.abs(rng.normal(size=(samples, SIZE)))
        return fitted(prior, terms, terms @ truth + noise * rng.normal(size=samples)).weight

    few, many = weights(60, 30.0), weights(6000, 0.1)
    factor = few @ prior.weight / (prior.weight @ prior.weight)
    assert factor > 0.2 and np.abs(few - factor * prior.weight).max() < 0.2 * factor
    np.testing.assert_allclose(many, truth, atol=0.02)


def test_noise_that_lasts_for_a_recording_counts_as_one_sample_of_it() -> None:
    """A floor, a heat or a charge of its own shifts a whole recording: three of them say less than their samples."""
    prior = expected(KIND, np.ones(SIZE), 0.3)
    terms, target = problem(4, 2.0 * prior.weight)
    steady, shifted = fitted(prior, terms, target), fitted(prior, terms, target + np.repeat([1.0, -1.0], 200), parts=2)
    assert shifted.noise > 30 * steady.noise
    new = [every(terms)]
    doubts = [np.linalg.norm(drives.doubt([terms], [target], new, 0)) for drives in (steady, shifted)]
    assert doubts[1] > 2 * doubts[0]


def test_only_new_readings_count() -> None:
    prior = expected(KIND, np.ones(SIZE), 0.3)
    terms, target = problem(6, 2.0 * prior.weight)
    new = np.arange(len(target)) % 4 == 0
    spoilt = np.where(new, target, 1e3)
    one, other = Drives(prior, None), Drives(prior, None)
    one.fit([terms], [spoilt], [new], np.zeros(1), 20, 0)
    other.fit([terms[new]], [target[new]], [every(terms[new])], np.zeros(1), 5, 0)
    np.testing.assert_allclose(one.weight, other.weight, rtol=1e-9)


def test_what_few_gaits_suggest_is_no_gift() -> None:
    """Two gaits in which hard pushes happen to come with a low level: no weight may call them a gain."""
    rng = np.random.default_rng(3)
    terms = np.abs(rng.normal(size=(600, SIZE)))
    target = terms[:, : len(KIND)].sum(1) + 0.1 * rng.normal(size=600)
    target -= 0.8 * terms[:, -len(KIND) :].sum(1)
    drives = fitted(expected(KIND, np.ones(SIZE), 0.3), terms, target, parts=2)
    assert (drives.weight >= 0).all()
    assert drives.weight[-len(KIND) :].max() < 0.02  # and what is left of them is nothing


def test_what_is_expected_are_copper_loss_and_work_and_how_far_drives_are_from_it() -> None:
    size = np.repeat([40.0, 20.0, 15.0, 5.0, 4.0, 30.0, 3000.0], len(KIND))
    prior = expected(KIND, size, 0.3)
    watts = prior.weight / size
    np.testing.assert_allclose(watts.reshape(TERMS, -1)[:, 0], [0.3, 0.5, 0.5, 0, 0, 0, 0])
    assert np.linalg.eigvalsh(prior.covariance).min() > 0
    spread = np.sqrt(np.diag(prior.covariance)) / size
    done = np.zeros(SIZE)
    done[[len(KIND), 2 * len(KIND)]] = 1 / size[[len(KIND), 2 * len(KIND)]]  # both weights of one joint's work
    assert np.sqrt(done @ prior.covariance @ done) == pytest.approx(np.hypot(0.05, np.hypot(0.02, 0.03)))
    assert spread[len(KIND)] == pytest.approx(0.29, abs=0.01)  # of what is generated nobody knows the use
    geared = expected(KIND, size, 0.3, [1.0 + kind for kind in KIND])
    np.testing.assert_allclose((geared.weight / size)[: len(KIND)], 0.3 / (1.0 + KIND) ** 2)
    assert geared.covariance[0, 0] == pytest.approx((0.3 * size[0]) ** 2 * (0.5**2 + 0.25**2 + 0.13**2))
    nothing = expected(KIND, size, None)
    assert np.sqrt(nothing.covariance[0, 0]) == pytest.approx(10 * np.sqrt(prior.covariance[0, 0]))


@pytest.mark.parametrize(
    ("residuals", "expected"),
    [
        # Of blocks of two: 2 · 1² and 2 · 2², 5 in the mean. The last reading is of no whole block. Of the recording:
        # 5 · 0.4² = 0.8; of each reading: (1 + 1 + 4 + 4) / 5 = 2.
        ([[1, 1, -2, -2, 0]], 5.0),
        # What is no reading counts for nothing: blocks 1 · 1² and 2 · 2², 4.5 in the mean.
        ([[1, None, -2, -2]], 4.5),
        # Nor does a block without a reading: 2 · 2² of the other one.
        ([[None, None, -2, -2]], 8.0),
        # Each recording has a level of its own: 4 · 1² of each, blocks 2 · 1².
        ([[1, 1, 1, 1], [-1, -1, -1, -1]], 4.0),
        # Readings that have nothing to do with each other: (1 + 9) / 2; of the block 2 · 1² = 2.
        ([[-1, 3]], 5.0),
        # One that is shorter than a block is one.
        ([[3]], 9.0),
    ],
)
def test_the_variance_is_of_readings_as_if_each_had_its_own(residuals, expected):
    """Weights and level are 0, so the residuals are the targets."""
    drives = Drives(drawn(0), None)
    logs = []
    for one in residuals:
        target = np.array([0.0 if value is None else value for value in one], dtype=float)
        logs.append((np.zeros((len(one), SIZE)), target, np.array([value is not None for value in one])))
    assert drives._variance(logs, block=2, longest=0) == pytest.approx(expected)
