"""Selectors: two decisions on plain numbers."""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress

from hts.contracts import Comparison, Selector, SimulatedCandidate, TestedCandidate
from hts.errors import HtsError, PluginError
from hts.plugins import Entry, Registry
from hts.testing.checks.ensure import after, ensure

NAMES = tuple(f"00-{index:02d}" for index in range(6))


def picks_elites(entry: Entry, registry: Registry) -> None:
    """Made without settings; elites are as many as asked for, each once, the same again; its list is only read."""
    selector = entry.factory({})
    ensure(isinstance(selector, Selector), f"is a {type(selector).__name__}, not a hts.contracts.Selector")
    for candidates in (_simulated(1), _simulated(2)):
        given = list(candidates)
        for count in (1, 3, 9):
            elites = _ids(selector.elites(given, count))
            ensure(given == candidates, "elites changes the list that it is given in place")
            ensure(len(elites) <= count, f"{count} were asked for, elites are {elites}")
            ensure(
                len(set(elites)) == len(elites) and set(elites) <= set(NAMES), f"elites are {elites} of {list(NAMES)}"
            )
            ensure(bool(elites), f"elites of {len(given)} candidates are none")
            again = list(selector.elites(list(candidates), count))
            ensure(elites == again, "elites differ from one time to the next")


@after(picks_elites)
def puts_unfit_last(entry: Entry, registry: Registry) -> None:
    """A candidate that fell, missed the speed or has no score (NaN) is no elite before those that are sound."""
    sound = [SimulatedCandidate(name, -float(i), 0, True, {"one": -float(i)}) for i, name in enumerate(NAMES[:3])]
    unfit = [
        SimulatedCandidate(NAMES[3], 9.0, 2, True, {"one": 9.0}),
        SimulatedCandidate(NAMES[4], 9.0, 0, False, {"one": 9.0}),
        SimulatedCandidate(NAMES[5], math.nan, 0, True, {"one": math.nan}),
    ]
    elites = list(entry.factory({}).elites([*unfit, *sound], 3))
    chosen = [candidate for candidate in unfit if candidate.id in elites]
    for candidate in chosen:
        facts = f"score {candidate.score:g}, {candidate.falls} falls, speed {'kept' if candidate.tracked else 'missed'}"
        ensure(False, f"takes a candidate with {facts} before three sound ones")


def chooses_the_best(entry: Entry, registry: Registry) -> None:
    """The best is one of those tested, the same again; None with nobody, nobody better, or numbers that are NaN."""
    selector = entry.factory({})
    for objectives in (1, 2):
        tested = [_tested(name, 0.1 * (index + 1), objectives) for index, name in enumerate(NAMES)]
        given = list(tested)
        best = selector.best(given)
        ensure(given == tested, "best changes the list that it is given in place")
        ensure(best is None or isinstance(best, str), f"best gives a {type(best).__name__}, expected an id or None")
        ensure(best in NAMES, f"of {len(tested)} candidates that are all better the best is {best!r}")
        ensure(best == selector.best(list(tested)), "the best differs from one time to the next")
        worse = [_tested(name, -0.1 * (index + 1), objectives) for index, name in enumerate(NAMES)]
        ensure(selector.best(worse) is None, f"of candidates that are all worse the best is {selector.best(worse)!r}")
        unknown = [_tested(name, math.nan, objectives) for name in NAMES]
        ensure(
            selector.best(unknown) is None, f"of candidates that measured NaN the best is {selector.best(unknown)!r}"
        )
    ensure(selector.best([]) is None, f"with nothing tested the best is {selector.best([])!r}")


def looks_at_a_runs_objectives(entry: Entry, registry: Registry) -> None:
    """check of the names of a run's objectives gives nothing, or refuses them in one line of hts.errors."""
    selector = entry.factory({})
    for names in (("objective-0",), ("objective-0", "objective-1")):
        with suppress(HtsError):
            selector.check(names)


def _ids(elites: object) -> list[str]:
    """What elites gave, if these are texts in a list."""
    if isinstance(elites, str) or not isinstance(elites, Sequence):
        raise PluginError(f"elites gives a {type(elites).__name__}, expected a list of ids")
    for one in elites:
        ensure(isinstance(one, str), f"elites gives a list with a {type(one).__name__}, expected one of ids")
    return list(elites)


def _simulated(objectives: int) -> list[SimulatedCandidate]:
    names = [f"objective-{n}" for n in range(objectives)]
    scores = [0.3, -0.2, 0.5, 0.1, 0.4, 0.2]
    return [
        SimulatedCandidate(name, score * objectives, 0, True, {one: score * (-1) ** n for n, one in enumerate(names)})
        for name, score in zip(NAMES, scores, strict=True)
    ]


def _tested(name: str, gain: float, objectives: int) -> TestedCandidate:
    return TestedCandidate(name, {f"objective-{n}": Comparison(gain, gain) for n in range(objectives)}, False)


CHECKS = (looks_at_a_runs_objectives, picks_elites, puts_unfit_last, chooses_the_best)
