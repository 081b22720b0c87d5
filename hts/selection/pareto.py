"""`pareto`: for several objectives. Elites cover the simulated front; the best is the measured compromise.

Elites: non-dominated sorting and crowding distance of K. Deb, A. Pratap, S. Agarwal, T. Meyarivan, A fast and elitist
multiobjective genetic algorithm: NSGA-II, IEEE Trans. Evolutionary Computation 6 (2002) 182; crowding is found anew
after each removal, S. Kukkonen and K. Deb, Improved pruning of non-dominated solutions, IEEE CEC (2006) 1179.
Best: the largest product of gains over the reference, J. F. Nash, The bargaining problem, Econometrica 18 (1950) 155;
with weights, E. Kalai, Nonsymmetric Nash solutions, Int. J. Game Theory 6 (1977) 129.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from pydantic import Field, field_validator

from hts.config import Config
from hts.contracts import Selector, Settings, SimulatedCandidate, TestedCandidate
from hts.errors import ConfigError, unknown_name
from hts.selection.fronts import gain_product, layers, spread


class ParetoSettings(Config):
    """Settings of `pareto`."""

    weights: dict[str, float] = Field(
        default_factory=dict,
        description="how much each objective counts for the best: exponent of its gain; missing: 1; 0: not at all",
    )
    allow_falls: bool = Field(False, description="may a candidate that fell in reality be the best one")

    @field_validator("weights")
    @classmethod
    def _not_negative(cls, weights: dict[str, float]) -> dict[str, float]:
        for name, weight in weights.items():
            if not (math.isfinite(weight) and weight >= 0):
                raise ValueError(f"{name}: {weight} is not a number of at least 0")
        return weights


class Pareto(Selector):
    """Elites along the simulated front, the best by the product of measured gains.

    As with `hierarchical`, a candidate that fell or missed the speed in simulation comes behind all that did not.
    With one objective both choose the same.
    """

    def __init__(self, settings: ParetoSettings) -> None:
        self.settings = settings

    def check(self, objectives: Sequence[str]) -> None:
        self._check_weights(dict.fromkeys(objectives))

    def elites(self, candidates: Sequence[SimulatedCandidate], count: int) -> list[str]:
        """Ids of `count` candidates, front by front; of the front that does not fit whole, those that cover it best.

        Within a front: best first in the first objective. One with a score that is not a number comes last of all, and
        whoever has the very scores of an earlier one (the same walk) behind all others that are no worse off.
        """
        groups: dict[tuple[bool, bool, bool], list[SimulatedCandidate]] = {}
        for candidate in candidates:
            unknown = any(math.isnan(value) for value in scores(candidate))
            groups.setdefault((unknown, candidate.falls > 0, not candidate.tracked), []).append(candidate)
        chosen: list[str] = []
        for key in sorted(groups):
            points = [scores(candidate) for candidate in groups[key]]
            for front in _layers(points):
                kept = [front[i] for i in spread([points[i] for i in front], min(len(front), count - len(chosen)))]
                kept.sort(key=lambda index: -points[index][0] if math.isfinite(points[index][0]) else math.inf)
                chosen += [groups[key][index].id for index in kept]
        return chosen

    def best(self, tested: Sequence[TestedCandidate]) -> str | None:
        """Id of the candidate with the largest product of selection scores; None if nobody improves on everything.

        The product of two candidates does not depend on a third, so that an earlier best can be compared again later.
        """
        products = [
            (self._product(candidate), candidate.id)
            for candidate in tested
            if candidate.comparisons and (self.settings.allow_falls or not candidate.fell)
        ]
        products = [(product, name) for product, name in products if product > 0]
        return max(products, key=lambda pair: pair[0])[1] if products else None

    def _product(self, candidate: TestedCandidate) -> float:
        self._check_weights(candidate.comparisons)
        gains = [comparison.selection_score for comparison in candidate.comparisons.values()]
        return gain_product(gains, [self.settings.weights.get(name, 1.0) for name in candidate.comparisons])

    def _check_weights(self, known: Mapping[str, Any]) -> None:
        for name in self.settings.weights:
            if name not in known:
                raise ConfigError("Selector 'pareto': weights: " + unknown_name("objective", name, known))
        if known and not any(self.settings.weights.get(name, 1.0) for name in known):
            raise ConfigError("Selector 'pareto': every weight is 0, so nothing could be the best. Leave one above 0.")


def scores(candidate: SimulatedCandidate) -> tuple[float, ...]:
    """One number per objective; the one score there is for a candidate that comes without parts."""
    return tuple(candidate.scores.values()) or (candidate.score,)


def _layers(points: Sequence[tuple[float, ...]]) -> list[list[int]]:
    """`layers`, then the points that equal an earlier one."""
    first = [index for index, point in enumerate(points) if point not in points[:index]]
    again = [index for index in range(len(points)) if index not in first]
    return [[first[index] for index in front] for front in layers([points[index] for index in first])] + [
        [index] for index in again
    ]


def make(settings: Settings) -> Selector:
    """Factory behind the name `pareto`."""
    return Pareto(ParetoSettings(**dict[str, Any](settings)))
