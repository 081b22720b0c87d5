"""`hierarchical`: the best K in simulation are tried in reality, the best of those goes on (Algorithm 1)."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from pydantic import Field

from hts.config import Config
from hts.contracts import Comparison, Selector, Settings, SimulatedCandidate, TestedCandidate
from hts.errors import ConfigError, unknown_name


class BestSettings(Config):
    """How the best is chosen, by `hierarchical` and by `racing`."""

    objective: str | None = Field(
        None, description="whose selection score decides when several run together; none: the first one of the run"
    )
    allow_falls: bool = Field(False, description="may a candidate that fell in reality be the best one")


class HierarchicalSettings(BestSettings):
    """Settings of `hierarchical`."""

    each_bound: bool = Field(
        False, description="the best of each KL bound is an elite, before any second one: what a trust region judges by"
    )
    at_random: int = Field(
        0,
        ge=0,
        description="so many of the elites are drawn among those that keep speed and feet: the best by a model are the "
        "ones it overrates most (winner's curse)",
    )


@dataclass(frozen=True, order=True)
class Rank:
    """What candidates are sorted by, the best first: a field decides among those that are alike in all before it.

    second: not the first of its KL bound, where each bound is to have one; speeds and score: larger is better, so
    negative here.
    """

    unknown: bool
    fell: bool
    off_speed: bool
    unpromised: bool
    speeds: int
    second: bool = field(default=False, kw_only=True)
    score: float = field(kw_only=True)


class Hierarchical(Selector):
    """Elites by simulated score, the best by measured selection score.

    A candidate that fell or missed the speed in simulation ranks behind all that did not, whatever its score: a
    policy that stands still or lies down measures cheapest. Ties keep the order given.
    """

    def __init__(self, settings: HierarchicalSettings) -> None:
        self.settings = settings

    def check(self, objectives: Sequence[str]) -> None:
        self._deciding(objectives)

    def elites(self, candidates: Sequence[SimulatedCandidate], count: int) -> list[str]:
        """Ids of the `count` best, best first. A score that is not a number ranks last of all.

        With several objectives the one that decides on the best decides here too, by its own score: the improvement
        that is predicted. Of whom none is, nothing was seen at the asked speeds, so r_real says nothing of walking at
        them: such candidates come behind the others, by mean r_real, as all do where nothing is predicted of anybody.
        Who is predicted at fewer speeds comes behind who is at more: its mean is over those at which it walks.
        """
        promises = any(self._promise(one) is not None for one in candidates)

        def rank(candidate: SimulatedCandidate) -> Rank:
            promise = self._promise(candidate)
            score = candidate.scores[self._deciding(candidate.scores)] if candidate.scores else candidate.score
            score = score if promise is None else promise
            unknown = math.isnan(score)
            return Rank(
                unknown,
                fell=candidate.falls > 0,
                off_speed=not candidate.tracked,
                unpromised=promises and promise is None,
                speeds=-(
                    candidate.predicted_speeds.get(self._deciding(candidate.scores), 0) if candidate.scores else 0
                ),
                score=0.0 if unknown else -score,
            )

        ordered = sorted(candidates, key=rank)
        if self.settings.each_bound:
            firsts = list({_bound(candidate): candidate for candidate in reversed(ordered)}.values())
            ordered = sorted(ordered, key=lambda one: replace(rank(one), second=one not in firsts))
        drawn = min(self.settings.at_random, max(0, count - 1))
        chosen, rest = ordered[: count - drawn], ordered[count - drawn :]
        sound = [candidate for candidate in rest if candidate.falls == 0 and candidate.tracked]
        return [candidate.id for candidate in (*chosen, *sorted(sound, key=_lot)[:drawn])]

    def _promise(self, candidate: SimulatedCandidate) -> float | None:
        """The deciding objective's improvement that is predicted of it; None where nothing is."""
        return candidate.predicted.get(self._deciding(candidate.scores)) if candidate.scores else None

    def best(self, tested: Sequence[TestedCandidate]) -> str | None:
        """Id with the highest selection score above zero; None if no candidate improves on the reference.

        With several objectives the one named in the settings decides, by default the first of the run: scores of
        different units have no sum.
        """
        improving = [
            (self._comparison(candidate).selection_score, candidate.id)
            for candidate in tested
            if candidate.comparisons and (self.settings.allow_falls or not candidate.fell)
        ]
        improving = [(score, name) for score, name in improving if score > 0]
        return max(improving, key=lambda pair: pair[0])[1] if improving else None

    def _comparison(self, candidate: TestedCandidate) -> Comparison:
        return candidate.comparisons[self._deciding(candidate.comparisons)]

    def _deciding(self, objectives: Iterable[str]) -> str:
        return deciding("hierarchical", self.settings, objectives)


def deciding(selector: str, settings: BestSettings, objectives: Iterable[str]) -> str:
    """The objective named in the settings, by default the first of these."""
    known = list(objectives)
    name = settings.objective or known[0]
    if name not in known:
        raise ConfigError(f"Selector '{selector}': " + unknown_name("objective", name, known))
    return name


def _bound(candidate: SimulatedCandidate) -> float:
    """c, nats; one value for all that do not say."""
    return candidate.made.kl_bound if candidate.made is not None else math.inf


def _lot(candidate: SimulatedCandidate) -> bytes:
    """A draw that only hangs on who it is, so that asking again gives the same: not on any score."""
    return hashlib.sha256(candidate.id.encode()).digest()


def make(settings: Settings) -> Selector:
    """Factory behind the name `hierarchical`."""
    return Hierarchical(HierarchicalSettings(**dict[str, Any](settings)))
