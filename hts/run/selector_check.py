"""A selector, tried on made-up candidates before anything is spent: a misspelt attribute shows at once, and not when a
robot has walked for the candidates that it is to choose from."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from hts.checked_selector import checked_selector
from hts.config import Named
from hts.contracts import Comparison, FineTuning, SimulatedCandidate, TestedCandidate
from hts.errors import HtsError, PluginError
from hts.plugins import Registry
from hts.run.score_check import MISTAKES

NAMES = ("00-00", "00-01")


def check_selector(registry: Registry, named: Named, comparisons: Mapping[str, Comparison | None]) -> None:
    """Raise PluginError for a selector whose rounds, elites or best are no answers, or fail as other candidates would
    not mend. comparisons: objective -> one of its own, with the metrics that it gives; where one of them is None, which
    metrics there will be is not known, and nobody is asked for the best."""
    selector = checked_selector(registry, named)
    measured = {name: found for name, found in comparisons.items() if found is not None}
    questions: list[Callable[[], object]] = [
        selector.rounds,
        lambda: selector.elites(simulated(tuple(comparisons)), len(NAMES)),
    ]
    if len(measured) == len(comparisons):
        questions.append(lambda: selector.best(tested(measured)))
    for asked in questions:
        try:
            asked()
        except PluginError as error:
            if error.__cause__ is None or isinstance(error.__cause__, MISTAKES):
                raise
        except HtsError:  # its opinion of candidates that nobody trained
            continue


def simulated(objectives: tuple[str, ...]) -> list[SimulatedCandidate]:
    """Two that stayed on their feet, one better than the other, in a run of these objectives."""
    return [
        SimulatedCandidate(
            id=name,
            score=-rank * len(objectives),
            falls=0,
            tracked=True,
            scores=dict.fromkeys(objectives, -float(rank)),
            made=_made(objectives),
            predicted=dict.fromkeys(objectives, 0.1),
            predicted_speeds=dict.fromkeys(objectives, 1),
        )
        for rank, name in enumerate(NAMES)
    ]


def tested(comparisons: Mapping[str, Comparison]) -> list[TestedCandidate]:
    """Two that measured so."""
    return [TestedCandidate(name, dict(comparisons), False, _made(tuple(comparisons))) for name in NAMES]


def _made(objectives: tuple[str, ...]) -> FineTuning:
    return FineTuning("pretrained", dict.fromkeys(objectives, 1.0), 1.0, 0.5, 1.0, 1.0)
