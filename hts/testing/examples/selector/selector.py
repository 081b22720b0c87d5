"""The selector `plain`: which candidates are worth the robot's time, and which of the tested ones goes on.

As it stands: the best in simulation are tested, and of those that stayed on their feet and got better in every
objective, the one with the largest smallest gain is the next anchor.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from pydantic import Field

from hts.config import Config
from hts.contracts import Selector, SimulatedCandidate, TestedCandidate


class Settings(Config):
    """Settings of the selector: `--set selection.selector.least=0.01`. A key that is not here is refused."""

    least: float = Field(0.0, ge=0, description="smallest gain that counts, in the unit of each objective")


class Plain(Selector):
    """Two decisions, each a function of what it is given."""

    def __init__(self, settings: Settings | None = None) -> None:
        self.settings = settings or Settings()

    def elites(self, candidates: Sequence[SimulatedCandidate], count: int) -> list[str]:
        """Ids to test, best first. Whoever fell or missed the speed comes last: standing still measures cheapest."""

        def rank(candidate: SimulatedCandidate) -> tuple[bool, bool, bool, float]:
            unknown = math.isnan(candidate.score)
            return (unknown, candidate.falls > 0, not candidate.tracked, 0.0 if unknown else -candidate.score)

        return [candidate.id for candidate in sorted(candidates, key=rank)[:count]]

    def best(self, tested: Sequence[TestedCandidate]) -> str | None:
        """Id of the next anchor; None if nobody is better than the pretrained policy."""
        gains = {c.id: least_gain(c) for c in tested if c.comparisons and not c.fell}
        better = {name: gain for name, gain in gains.items() if gain > self.settings.least}
        return max(better, key=lambda name: better[name]) if better else None


def least_gain(candidate: TestedCandidate) -> float:
    """The gain in the objective that gained least; units differ, so several objectives need a scale of yours here."""
    return min(comparison.selection_score for comparison in candidate.comparisons.values())
