"""`racing`: short rounds of head-to-heads, until it is known well enough who is best.

A race (Maron and Moore 1994, NIPS 6:59; Birattari et al. 2002, GECCO:11) with paired t-tests (t-race: López-Ibáñez et
al. 2016, Operations Research Perspectives 3:43), a fixed number of looks, and Bonferroni's bound over looks and
comparisons. It stops when nobody left can be better than the leader by more than an indifference (Even-Dar, Mannor and
Mansour 2006, JMLR 7:1079). `docs/evaluation.md` has the derivation.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Literal

import numpy as np
from pydantic import Field

from hts.contracts import (
    Comparison,
    RacedCandidate,
    Rounds,
    Selector,
    Settings,
    SimulatedCandidate,
    TestedCandidate,
)
from hts.errors import PluginError
from hts.quantiles import student_quantile
from hts.selection import anytime
from hts.selection.hierarchical import BestSettings, Hierarchical, HierarchicalSettings, deciding


class RacingSettings(BestSettings):
    """Settings of `racing`."""

    block_seconds: float = Field(15.0, ge=1, description="length of each block of a round, s")
    rounds: int = Field(
        4,
        ge=1,
        description="rounds at most: the budget. By score nobody leaves after the last or, with rounds as units, the "
        "first, so less than three end nothing early",
    )
    test: Literal["looks", "anytime"] = Field(
        "looks",
        description="looks: t-tests at `rounds` looks fixed before; anytime: confidence sequences, "
        "whose error does not depend on `rounds`",
    )
    unit: Literal["half", "round"] = Field(
        "round",
        description="round: one number a round and candidate, the mean of its halves; half: two numbers, which decide "
        "sooner, and rightly only if a session favours nobody",
    )
    error: float = Field(
        0.05, gt=0, lt=1, description="alpha: probability, over the whole race, that the best one is dropped"
    )
    indifference: float = Field(
        0.03, ge=0, description="differences below this share of the leader's selection score do not matter"
    )


class Racing(Selector):
    """Elites and best as `hierarchical`; who is worth another round is decided after each."""

    def __init__(self, settings: RacingSettings) -> None:
        self.settings = settings
        self._choice = Hierarchical(
            HierarchicalSettings(objective=settings.objective, allow_falls=settings.allow_falls)
        )

    def check(self, objectives: Sequence[str]) -> None:
        deciding("racing", self.settings, objectives)

    def elites(self, candidates: Sequence[SimulatedCandidate], count: int) -> list[str]:
        """As `hierarchical`."""
        return self._choice.elites(candidates, count)

    def best(self, tested: Sequence[TestedCandidate]) -> str | None:
        """As `hierarchical`: the highest measured selection score above zero, over all rounds of each."""
        return self._choice.best(tested)

    def rounds(self) -> Rounds:
        """Rounds of `settings.block_seconds`, at most `settings.rounds`."""
        return Rounds(self.settings.block_seconds, self.settings.rounds)

    def keep(self, raced: Sequence[RacedCandidate]) -> list[str]:
        """Ids that get another round, in the order given; one or none if the race is decided.

        Out is who could not be measured, who fell (unless that is allowed), who is clearly worse than the leader, and
        who is clearly no better than the reference.
        """
        able = [one for one in raced if one.tested is not None and (self.settings.allow_falls or not one.tested.fell)]
        for one in raced:
            if len(one.halves) % 2:
                raise PluginError(
                    f"Selector 'racing': {one.id} has {len(one.halves)} halves, expected two of each round. The world "
                    "must walk two blocks of everybody in a round (`World.head_to_head_round`)."
                )
        racing = [index for index, one in enumerate(able) if one.racing]
        if len(racing) < 2:
            return [able[index].id for index in racing]
        table = _table([[self._score(half) for half in one.halves] for one in able])
        if self.settings.unit == "round":
            table = of_rounds(table)
        if self.settings.test == "anytime":
            left = anytime.still_racing(table, racing, self.settings.error / len(raced), self.settings.indifference)
            return [able[index].id for index in left]
        level = self.level(len(raced))
        racing = [index for index in racing if not _clearly_below_zero(table[index], level)]
        return [able[index].id for index in still_racing(table, racing, level, self.settings.indifference)]

    def level(self, candidates: int) -> float:
        """Error probability of one comparison at one look: `error` shared among all comparisons of the best of so many
        candidates, and all looks that can decide. Nothing is decided after the last round, nor after one unit alone."""
        looks = self.settings.rounds - (2 if self.settings.unit == "round" else 1)
        return self.settings.error / (max(1, looks) * candidates)

    def _score(self, half: Any) -> float:
        """Selection score of a half by the objective that decides; NaN for one that could not be compared."""
        if half is None:
            return math.nan
        comparison: Comparison = half[deciding("racing", self.settings, half)]
        return comparison.selection_score


def of_rounds(table: np.ndarray) -> np.ndarray:
    """Scores of halves as scores of rounds: (candidates, 2 rounds) -> (candidates, rounds), the mean of the two; NaN
    where one of them was not measured, since a drift cancels in a whole round alone."""
    return table.reshape(len(table), -1, 2).mean(-1)


def still_racing(table: np.ndarray, racing: Sequence[int], level: float, indifference: float) -> list[int]:
    """Rows of `table` that another round is worth, of those in `racing`; the leader alone if it is decided.

    table: score of each candidate in each unit, (candidates, units), NaN where it was not measured; units are halves
    or rounds. level: error probability of one comparison, one-sided. indifference: share of the leader's mean score.

    With n units in common, the difference of two candidates has the standard error √(2 s²/n), where s² is what
    candidates and units leave unexplained of the table; d > t·√(2 s²/n) is "clearly worse", and the race is decided
    when t·√(2 s²/n) − d ≤ indifference · leader's mean for everybody left. Units are taken as independent: of
    halves, what both of a session have in common for one candidate alone is not allowed for, and `docs/evaluation.md`
    says what it costs.
    """
    if len(racing) < 2:
        return list(racing)
    means = {row: float(np.nanmean(table[row])) if np.isfinite(table[row]).any() else -math.inf for row in racing}
    leader = max(racing, key=lambda row: means[row])
    variance, degrees = residual_variance(table)
    behind = {row: _difference(table[leader], table[row], variance, degrees, level) for row in racing if row != leader}
    left = {row: found for row, found in behind.items() if found[0] <= found[1]}
    worth = indifference * max(means[leader], 0.0)
    if all(width - difference <= worth for difference, width in left.values()):
        return [leader]
    return [row for row in racing if row == leader or row in left]


def residual_variance(table: np.ndarray) -> tuple[float, int]:
    """s² and its degrees of freedom: what a mean per row and a mean per column leave of the table. NaN are gaps.

    A column's mean takes out what all candidates of a unit have in common: the reference's block, charge, heat.
    """
    rows, columns = np.nonzero(np.isfinite(table))
    if len(rows) == 0:
        return 0.0, 0
    design = np.zeros((len(rows), sum(table.shape)))
    design[np.arange(len(rows)), rows] = 1.0
    design[np.arange(len(rows)), table.shape[0] + columns] = 1.0
    values = table[rows, columns]
    solution, _, rank, _ = np.linalg.lstsq(design, values, rcond=None)
    degrees = len(rows) - int(rank)
    left = values - design @ solution
    return (float(left @ left) / degrees if degrees else 0.0), degrees


def _difference(
    leader: np.ndarray, other: np.ndarray, variance: float, degrees: int, level: float
) -> tuple[float, float]:
    """How far `other` lies behind, over the units they have in common, and how wide that is at this level."""
    differences = (leader - other)[np.isfinite(leader) & np.isfinite(other)]
    if degrees < 1 or len(differences) == 0:
        return 0.0, math.inf
    return float(differences.mean()), _quantile(level, degrees) * math.sqrt(2 * variance / len(differences))


def _clearly_below_zero(units: np.ndarray, level: float) -> bool:
    """Whether a candidate is no better than the reference, from its own units alone."""
    found = units[np.isfinite(units)]
    if len(found) < 2:
        return False
    width = _quantile(level, len(found) - 1) * float(found.std(ddof=1)) / math.sqrt(len(found))
    return float(found.mean()) + width < 0.0


def _quantile(level: float, degrees: int) -> float:
    """Of Student's t, exceeded with probability `level`."""
    return -student_quantile(level, degrees)


def _table(rows: Sequence[Sequence[float]]) -> np.ndarray:
    """Rows of unequal length as one array, NaN where one ended earlier."""
    table = np.full((len(rows), max((len(row) for row in rows), default=0)), math.nan)
    for index, row in enumerate(rows):
        table[index, : len(row)] = row
    return table


def make(settings: Settings) -> Selector:
    """Factory behind the name `racing`."""
    return Racing(RacingSettings(**dict[str, Any](settings)))
