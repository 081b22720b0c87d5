"""A 95 % interval for a comparison whose segments follow each other in time.

Neighbouring segments are alike (a stride is like the next, heat and heading wander slowly), so resampling single
segments would give an interval that is far too narrow. Contiguous batches of segments are resampled instead
(block bootstrap: Künsch 1989, Annals of Statistics 17:1217; batch means: Flegal and Jones 2010, Annals of
Statistics 38:1034), each within its own block of the head-to-head, because a block's mean time is part of the
design. `docs/evaluation.md` derives the two corrections for short series.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from hts.quantiles import normal_quantile, student_quantile

MAX_BIAS = 0.1  # batches so long that their means lose at most this share of the variance to their neighbours
MIN_BATCH = 5  # segments
MIN_BATCHES = 3  # per block
LEVEL = 0.95
STEP = 0.01  # of the way from the mean to a segment: a derivative

Means = Sequence[np.ndarray]


def interval(
    statistic: Callable[[np.ndarray, np.ndarray], float],
    policy: Sequence[np.ndarray],
    reference: Sequence[np.ndarray],
    resamples: int = 2000,
    seed: int = 0,
) -> tuple[float, float] | None:
    """Interval of `statistic(policy mean, reference mean)`, each mean of shape (Q,), that of the means of blocks.

    policy, reference: one array (segments, Q) per uninterrupted block, in time order. The same seed gives the same
    interval. Blocks of a single segment each are joined, as they say nothing alone; None if that leaves one segment, or
    if the statistic of a draw is no finite number.
    One correlation is taken for both, so where only one of the two wanders the interval is too narrow
    (`docs/evaluation.md` says by how much).
    """
    groups = (_joined_if_single(policy), _joined_if_single(reference))
    means = [np.mean([block.mean(axis=0) for block in blocks], axis=0) for blocks in groups]
    point = statistic(means[0], means[1])
    effects = _linearised(statistic, groups, means, point)
    if not all(np.isfinite(one).all() for one in effects):
        return None
    correlation = lag_one_correlation(effects)
    batches = [[_batch(block, correlation) for block in blocks] for blocks in groups]
    degrees = _degrees(batches, correlation)
    if degrees is None:
        return None
    rng = np.random.default_rng(seed)
    drawn = [_resampled_means(blocks, resamples, rng) for blocks in batches]
    values = np.array([statistic(p, r) for p, r in zip(drawn[0], drawn[1], strict=True)])
    if not np.isfinite(values).all():
        return None
    quantile = (1 + LEVEL) / 2
    low, high = np.quantile(values, [1 - quantile, quantile])
    stretch = student_quantile(quantile, degrees) / normal_quantile(quantile)
    stretch *= np.sqrt(_variance_ratio(batches, correlation))
    return (float(point + (low - point) * stretch), float(point + (high - point) * stretch))


def lag_one_correlation(blocks: Sequence[np.ndarray]) -> float:
    """Correlation of neighbours in series (segments,), pooled over blocks, between 0 and 0.95.

    In a block of m segments, deviations from the block's own mean make the plain estimate too small, on average by
    (1 + 3φ)/m (Marriott and Pope 1954, Biometrika 41:390); this is undone. Negative values are taken as 0.
    """
    long_enough = [block - block.mean() for block in blocks if len(block) > 4]
    squares = sum(float(block @ block) for block in long_enough)
    if squares <= 0.0:
        return 0.0
    mean_length = np.mean([len(block) for block in long_enough])
    neighbours = sum(float(block[1:] @ block[:-1]) for block in long_enough)
    plain = neighbours / squares * mean_length / (mean_length - 1)
    return float(np.clip((mean_length * plain + 1) / (mean_length - 3), 0.0, 0.95))


def variance_of_mean(count: float, correlation: float) -> float:
    """Variance of the mean of `count` neighbours of an AR(1) series of unit variance.

    V(n) = (1/n)·[(1 + φ)/(1 − φ) − 2φ(1 − φⁿ)/(n(1 − φ)²)], the sum of φ^|i−j| over all pairs divided by n².
    """
    phi = correlation
    return ((1 + phi) / (1 - phi) - 2 * phi * (1 - phi**count) / (count * (1 - phi) ** 2)) / count


def _joined_if_single(blocks: Sequence[np.ndarray]) -> list[np.ndarray]:
    return list(blocks) if any(len(block) > 1 for block in blocks) else [np.concatenate(blocks)]


def _linearised(
    statistic: Callable[[np.ndarray, np.ndarray], float],
    groups: tuple[Sequence[np.ndarray], Sequence[np.ndarray]],
    means: list[np.ndarray],
    point: float,
) -> list[np.ndarray]:
    """What each segment does to the statistic, one series (segments,) per block: its correlation is what matters."""
    policy = [
        np.array([statistic(means[0] + STEP * (row - means[0]), means[1]) - point for row in block])
        for block in groups[0]
    ]
    reference = [
        np.array([statistic(means[0], means[1] + STEP * (row - means[1])) - point for row in block])
        for block in groups[1]
    ]
    return policy + reference


def _batch(block: np.ndarray, correlation: float) -> tuple[np.ndarray, np.ndarray]:
    """Means (batches, Q) and sizes (batches,) of nearly equal contiguous parts of a block (segments, Q).

    By `variance_of_mean`, means of L segments miss a share 2φ / (L(1 − φ²)) of the variance; L keeps it below MAX_BIAS.
    """
    length = max(MIN_BATCH, 2 * correlation / (1 - correlation**2) / MAX_BIAS)
    count = min(len(block), max(MIN_BATCHES, int(len(block) // length)))
    parts = np.array_split(block, count)
    return np.stack([part.mean(axis=0) for part in parts]), np.array([len(part) for part in parts])


def _resampled_means(
    blocks: list[tuple[np.ndarray, np.ndarray]], resamples: int, rng: np.random.Generator
) -> np.ndarray:
    """Means (resamples, Q) over all blocks, batches drawn with replacement within their own block."""
    result = np.zeros((resamples, blocks[0][0].shape[1]))
    for means, _ in blocks:
        chosen = rng.integers(0, len(means), size=(resamples, len(means)))
        result += means[chosen].mean(axis=1) / len(blocks)
    return result


def _degrees(batches: list[list[tuple[np.ndarray, np.ndarray]]], correlation: float) -> float | None:
    """Degrees of freedom of what the batches show of the variance (Satterthwaite 1946, Biometrics Bulletin 2:110), as
    far as it comes of blocks with several of them; None where none has. Batches - blocks for blocks of one length; next
    to one that is left with few segments, and counts the same, little more than that one's own."""
    parts = [
        (variance_of_mean(int(sizes.sum()), correlation) / len(blocks) ** 2, len(sizes) - 1)
        for blocks in batches
        for _, sizes in blocks
    ]
    spread = sum(variance**2 / degrees for variance, degrees in parts if degrees)
    return sum(variance for variance, degrees in parts if degrees) ** 2 / spread if spread else None


def _variance_ratio(batches: list[list[tuple[np.ndarray, np.ndarray]]], correlation: float) -> float:
    """True variance of the means over what the bootstrap shows on average, were the series AR(1).

    In a block of m segments in k batches the bootstrap shows (V(m/k) − V(m))/k, because batches are measured from
    their own block's mean and are themselves a little alike; the truth is V(m).
    """
    true = shown = 0.0
    for blocks in batches:
        share = 1 / len(blocks) ** 2
        for _, sizes in blocks:
            count, length = len(sizes), int(sizes.sum())
            true += share * variance_of_mean(length, correlation)
            if count > 1:
                within = variance_of_mean(length / count, correlation) - variance_of_mean(length, correlation)
                shown += share * within / count
    return true / shown
