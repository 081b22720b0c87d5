"""An improvement "on machines like these": over realities, seeds of the method, and sessions.

The interval of one head-to-head says how that test would scatter on that machine. Whoever reads "saves 20 %" asks
about the next machine. Runs on one reality share that reality, so the realities are the units, not the runs: a
cluster bootstrap (Davison and Hinkley 1997, Bootstrap Methods and Their Application, §3.8) draws whole realities
with replacement, with all of their seeds and sessions, whose scatter is in the realities' means already. Drawing seeds
again within a drawn reality would count that scatter twice.

    y_rs = μ + b_r + e_rs,   ȳ_r = mean over seeds,   Var(ȳ_r) = σ_b² + σ_e²/n_r

Few realities show less than the whole spread. Draws are therefore stretched about the estimate by √(R/(R − 1)) and by
t/z with R − 1 degrees of freedom (expanded percentile interval, Hesterberg 2015, The American Statistician 69:371).
Each reality counts the same, however many seeds it has. With equal numbers of seeds a mixed model's interval of μ rests
on the same realities' means, so none is fitted here; its variance components are (`Spread`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from hts.errors import EvaluationError
from hts.quantiles import normal_quantile, student_quantile

Values = Mapping[str, Sequence[float | Sequence[float]]]
"""reality -> one number per seed, or one per session of each seed."""

Statistic = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Population:
    """estimate, and its interval (None with fewer than two realities); how many realities and runs are in it."""

    estimate: float
    interval: tuple[float, float] | None
    realities: int
    runs: int


@dataclass(frozen=True)
class Spread:
    """Standard deviations between realities (σ_b, without what seeds add) and between seeds of one (σ_e).

    None: no reality has two seeds; then `between` holds both.
    """

    between: float
    within: float | None


def mean(values: np.ndarray) -> np.ndarray:
    """Of the last axis: the default statistic."""
    return values.mean(axis=-1)


def quantile(share: float) -> Statistic:
    """Statistic: the quantile below which `share` of the realities lie. 0.5: the median."""
    return lambda values: np.quantile(values, share, axis=-1)


def population(
    values: Values, statistic: Statistic = mean, *, level: float = 0.95, resamples: int = 10_000, seed: int = 0
) -> Population:
    """A statistic of the realities' means, with its cluster bootstrap interval.

    statistic: of arrays (…, realities) over the last axis. The same seed gives the same interval. A quantile far from
    the median of few realities has no trustworthy interval: the bootstrap cannot see beyond the outermost one.
    That of the median of three, and of the mean of realities that are skewed, holds the truth less often than it says
    (`docs/evaluation.md`).
    Raises EvaluationError where there is no reality, one without a run, or a number that is not finite.
    """
    means = _means(values)
    runs = sum(len(seeds) for seeds in values.values())
    estimate = float(statistic(means))
    return Population(estimate, _interval(means, statistic, estimate, level, resamples, seed), len(means), runs)


def paired(
    first: Values,
    second: Values,
    statistic: Statistic = mean,
    *,
    level: float = 0.95,
    resamples: int = 10_000,
    seed: int = 0,
) -> Population:
    """`population` of first less second, reality by reality, over those that both have.

    What a reality does to both methods cancels. Seeds are not paired: another method's same seed is another run.
    Raises EvaluationError where they have no reality in common, and as `population`.
    """
    common = [name for name in first if name in second]
    if not common:
        raise EvaluationError(
            f"Nothing to pair: the first has runs on {_named(first)}, the second on {_named(second)}. Run both on the "
            "same realities."
        )
    ours, theirs = ({name: values[name] for name in common} for values in (first, second))
    differences = _means(ours) - _means(theirs)
    estimate = float(statistic(differences))
    runs = sum(len(values[name]) for values in (ours, theirs) for name in common)
    return Population(estimate, _interval(differences, statistic, estimate, level, resamples, seed), len(common), runs)


def spread(values: Values) -> Spread:
    """Variance components by the analysis of variance, on realities' means: σ_b² = Var(ȳ_r) − σ_e² · mean(1/n_r).

    A negative σ_b² is taken as 0. Raises EvaluationError as `population`, and for fewer than two realities.
    """
    means = _means(values)
    if len(means) < 2:
        raise EvaluationError(
            f"One reality ({_named(values)}) has no spread between realities. Run on another one too."
        )
    of_means = float(means.var(ddof=1))
    seeds = [np.array([_session_mean(one) for one in runs]) for runs in values.values()]
    degrees = sum(len(one) - 1 for one in seeds)
    if degrees == 0:
        return Spread(between=of_means**0.5, within=None)
    within = sum(float(((one - one.mean()) ** 2).sum()) for one in seeds) / degrees
    between = max(0.0, of_means - within * float(np.mean([1 / len(one) for one in seeds])))
    return Spread(between=between**0.5, within=within**0.5)


def _interval(
    means: np.ndarray, statistic: Statistic, estimate: float, level: float, resamples: int, seed: int
) -> tuple[float, float] | None:

    count = len(means)
    if count < 2:
        return None
    if not 0.0 < level < 1.0:
        raise EvaluationError(f"level is {level}. Expected a probability between 0 and 1, for instance 0.95.")
    chosen = np.random.default_rng(seed).integers(0, count, size=(resamples, count))
    drawn = statistic(means[chosen])
    upper = (1 + level) / 2
    low, high = np.quantile(drawn, [1 - upper, upper])
    stretch = student_quantile(upper, count - 1) / normal_quantile(upper) * np.sqrt(count / (count - 1))
    return float(estimate + (low - estimate) * stretch), float(estimate + (high - estimate) * stretch)


def _means(values: Values) -> np.ndarray:
    """Mean of each reality's runs, shape (realities,)."""
    if not values:
        raise EvaluationError("There is no reality to take a mean over. Expected at least one with a run.")
    found = []
    for name, runs in values.items():
        if len(runs) == 0:
            raise EvaluationError(f"Reality '{name}' has no run. Leave it out, or run on it.")
        one = float(np.mean([_session_mean(run) for run in runs]))
        if not np.isfinite(one):
            raise EvaluationError(f"Reality '{name}' has a number that is not finite: {list(runs)}. Look at its runs.")
        found.append(one)
    return np.array(found)


def _session_mean(run: float | Sequence[float]) -> float:
    return float(np.mean(run))


def _named(values: Values) -> str:
    return ", ".join(values) or "none"
