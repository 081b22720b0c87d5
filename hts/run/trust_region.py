"""How far candidates may go in the next iteration: the KL bounds follow how well promises were kept.

rho = sum of measured improvements / sum of predicted ones, over the elites that were tried, as in trust-region methods
of optimisation (Conn, Gould and Toint 2000, "Trust-Region Methods", chapter 6), where the model is that of the
objective and the region is a KL ball. Measurements are noisy and few, so the interval of rho decides and not rho.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from hts.config import TrustRegionConfig
from hts.quantiles import normal_quantile, student_quantile

ACTIVE = 0.8  # of c: a candidate whose KL is larger was held back by its bound
LEVEL = 0.95
PRIOR_SCATTER, PRIOR_ELITES = 0.15, 4
"""How far an elite's measured improvement lies from the common share of what was predicted for it, as a share of that,
and how many elites this is worth: from runs on the default twin and development realities."""


@dataclass(frozen=True)
class Tried:
    """An elite as it was tried: improvements in one unit, means over the same speeds; half_width: of the measured
    one's interval; kl and kl_bound, nats; fell: in reality."""

    id: str
    predicted: float
    measured: float
    half_width: float
    kl: float
    kl_bound: float
    fell: bool

    @property
    def active(self) -> bool:
        """Whether its bound held it back."""
        return math.isfinite(self.kl_bound) and self.kl > ACTIVE * self.kl_bound


@dataclass(frozen=True)
class Agreement:
    """rho and its interval; None where nothing was promised or nobody could be measured."""

    rho: float | None
    interval: tuple[float, float] | None

    def entry(self) -> dict[str, Any]:
        """As JSON."""
        return asdict(self)


def agreement(tried: Sequence[Tried]) -> Agreement:
    """Ratio of sums over elites (Cochran 1977, "Sampling Techniques", section 6.3), with an interval from the elites'
    scatter around the common ratio and from the measurement error of each.

    Two or three elites say little about scatter, so it has a prior worth PRIOR_ELITES of them, as a share of what was
    predicted: variance by the scaled inverse chi-squared distribution, interval by Student's t (Gelman et al. 2013,
    "Bayesian Data Analysis", section 2.6). So the interval holds what it says where elites scatter as the prior does,
    and less often where they scatter more (`docs/decisions.md` has how often).
    """
    total = sum(one.predicted for one in tried)
    if not tried or total <= 0:
        return Agreement(None, None)
    rho = sum(one.measured for one in tried) / total
    half = _half_width(tried, [one.measured - rho * one.predicted for one in tried]) / total
    return Agreement(rho, (rho - half, rho + half))


def clearly_below(tried: Sequence[Tried]) -> bool:
    """Whether the mean measured improvement is below the mean predicted one, by the scatter and the errors of
    `agreement`. A difference says so too where elites were predicted to lose, and a ratio says nothing."""
    shortfalls = [one.measured - one.predicted for one in tried]
    total = sum(shortfalls)
    return total + _half_width(tried, [one - total / len(tried) for one in shortfalls]) < 0


def _half_width(tried: Sequence[Tried], misses: Sequence[float]) -> float:
    """Of the interval of the sum of measured improvements. misses: how far each lies from what all have in common."""
    squares = sum(one.predicted**2 for one in tried)
    error = sum((one.half_width / normal_quantile((1 + LEVEL) / 2)) ** 2 for one in tried)
    degrees = PRIOR_ELITES + len(tried) - 1
    scatter = (PRIOR_ELITES * PRIOR_SCATTER**2 * squares + len(tried) * sum(miss**2 for miss in misses)) / degrees
    return float(student_quantile((1 + LEVEL) / 2, degrees) * math.sqrt(scatter + error))


def next_scale(
    scale: float, tried: Sequence[Tried], config: TrustRegionConfig, bounds: Sequence[float]
) -> tuple[float, str]:
    """The factor on all finite KL bounds in the next iteration, and why.

    bounds: c as given, nats. The factor goes no further than where the first of them meets its limit, so that what
    narrows it always narrows every bound: a factor that grew on beyond a limit would first have to come back.
    """
    finite = [c for c in bounds if math.isfinite(c)] or [1.0]
    low, high = sorted((config.least / min(finite), config.most / max(finite)))
    found, why = _unlimited(min(max(scale, low), high), tried, config)
    return min(max(found, low), high), why


def _unlimited(scale: float, tried: Sequence[Tried], config: TrustRegionConfig) -> tuple[float, str]:
    if any(one.fell for one in tried):
        return scale * config.shrink, "an elite fell"
    found = agreement(tried)
    if found.interval is None:
        if tried and clearly_below(tried):
            return scale * config.shrink, "none was predicted in sum, and measured ones are below the predicted ones"
        return scale, "nothing to judge by"
    low, high = found.interval
    if high < config.agreement:
        return scale * config.shrink, f"measured improvements are under {config.agreement:g} of the predicted ones"
    if low > config.agreement:
        if not any(one.active for one in tried):
            return scale, "no bound held anybody back"
        good, how = low > config.close, "more was saved than predicted" if low > 1 else "the prediction held"
        return scale * config.grow ** (2 if good else 1), f"{how}, and the bound held candidates back"
    return scale, "it cannot be told yet"


def scaled(bounds: Sequence[float], scale: float, config: TrustRegionConfig) -> tuple[float, ...]:
    """The KL bounds of an iteration, within the limits; infinity stays. Where they do not move, they stay as given."""
    if not config.enabled:
        return tuple(bounds)
    return tuple(c if math.isinf(c) else min(max(c * scale, config.least), config.most) for c in bounds)


def tried_elites(
    objective: str, candidates: Mapping[str, Mapping[str, Any]], results: Mapping[str, Mapping[str, Any]]
) -> list[Tried]:
    """From a run's stages. candidates: id -> kl, kl_bound and predicted, objective -> speed -> entry; results: of the
    stage `test`. Means are over the speeds that were both promised and measured with an interval: without one the error
    is not known, which is not the same as none. One that was refused for what it did itself (it fell, or did not keep
    to a speed) counts as a promise that was not kept at all, and one that fell counts even where nothing was promised;
    any other without such a speed, for instance one whose reference did not keep to it, is left out."""
    found = []
    for name, result in results.items():
        row, real = candidates[name], (result.get("real") or {}).get(objective) or {}
        promised = row["predicted"].get(objective, {})
        speeds = [speed for speed in real if speed in promised and real[speed]["improvement_ci95"]]
        refusal = result.get("refusal") or {}
        fell = bool((result.get("tested") or {}).get("fell") or result.get("refused_falls") or refusal.get("falls"))
        if not speeds and not fell and not (promised and refusal):
            continue
        over = speeds or list(promised)
        count = max(1, len(over))
        predicted = sum(promised[speed]["improvement"] for speed in over) / count
        measured = sum(real[speed]["improvement"] for speed in speeds) / count if speeds else min(0.0, predicted)
        widths = [real[speed]["improvement_ci95"] for speed in speeds]
        half = math.sqrt(sum(((ci[1] - ci[0]) / 2) ** 2 for ci in widths)) / count
        found.append(
            Tried(
                name,
                predicted,
                measured,
                half,
                math.nan if row["kl"] is None else row["kl"],
                math.inf if row["kl_bound"] is None else row["kl_bound"],  # JSON has neither
                fell,
            )
        )
    return found


def by_all(
    scale: float,
    objectives: Sequence[str],
    candidates: Mapping[str, Mapping[str, Any]],
    results: Mapping[str, Mapping[str, Any]],
    config: TrustRegionConfig,
    bounds: Sequence[float],
) -> tuple[float, str, Agreement]:
    """The factor on the KL bounds in the next iteration, why, and what that was seen by; arguments as of `next_scale`
    and `tried_elites`.

    Of several objectives each judges the elites that were trained for it (λ above 0), and the most cautious of those
    that have any counts: a bound that one model's promises do not bear is too wide.
    """
    found: list[tuple[float, str, Agreement]] = []
    for objective in objectives:
        own = {
            name: result
            for name, result in results.items()
            if len(objectives) == 1 or candidates[name]["weights"].get(objective, 0.0) > 0
        }
        tried = tried_elites(objective, candidates, own)
        if tried or (objective == objectives[-1] and not found):
            found.append((*next_scale(scale, tried, config, bounds), agreement(tried)))
    return min(found, key=lambda one: one[0])
