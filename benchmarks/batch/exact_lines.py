"""Lines of candidates that the reality's own instruments judged, and what they say of methods."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np
from pydantic import Field

from batch.lines import Part, RunLine, latest
from batch.tables import NONE, differences, shown, table, with_interval
from hts.errors import EvaluationError, unknown_name
from hts.evaluation.population import paired


class Judged(Part):
    """A candidate. share: how much of its training it has behind it; falls: in simulation; saved: objective -> speed ->
    improvement over the pretrained policy, in the objective's unit."""

    id: str
    share: float = 1.0
    weights: dict[str, float]
    kl_bound: float | None
    kl: float
    falls: int
    saved: dict[str, dict[str, float]]


class Exact(Part):
    """One iteration's candidates. units: of each objective's improvement; pull: m/s² at each of the speeds, where
    trials told it; seconds: of each stage, and of the judging."""

    iteration: int
    units: dict[str, str]
    speeds: list[float]
    candidates: list[Judged]
    pull: list[float] | None = None
    seconds: dict[str, float] = Field(default_factory=dict)

    @property
    def last(self) -> Judged:
        """The first candidate as its training ended."""
        return next(one for one in self.candidates if one.share == 1.0)


class ExactLine(RunLine):
    """A run until an iteration's candidates were trained."""

    result: Exact | None = None


def read_exact(paths: Iterable[Path]) -> list[ExactLine]:
    """As `batch.lines.read_lines`."""
    return latest(paths, ExactLine, "as benchmarks/realities.py exact run writes it")


def mean_of(saved: Mapping[str, float]) -> float:
    """Over speeds."""
    return float(np.mean(list(saved.values())))


Means = Mapping[str, Mapping[int, float]]
"""Reality -> seed -> the mean over speeds of what the last candidate saves."""


def exact_table(lines: Sequence[ExactLine], against: str | None = None) -> str:
    """Method by method and iteration by iteration, of the last candidates: each speed, the mean and, in pairs by
    reality and seed, the difference to one method. Raises EvaluationError for a method that no line is of."""
    done = [(line, line.result) for line in lines if line.result is not None]
    if not done:
        raise EvaluationError("These lines hold no candidates that were judged. Make some: realities.py exact run.")
    methods = list(dict.fromkeys(line.method for line, _ in done))
    if against is not None and against not in methods:
        raise EvaluationError(unknown_name("method", against, methods))
    objective, unit = next(iter(done[0][1].units.items()))
    speeds = list(dict.fromkeys(f"{speed:g}" for _, found in done for speed in found.speeds))
    show = shown(unit)
    rows = []
    for iteration in sorted({found.iteration for _, found in done}):
        own = {
            method: [
                (line, found.last) for line, found in done if (found.iteration, line.method) == (iteration, method)
            ]
            for method in methods
        }
        means = {method: _means(theirs, objective) for method, theirs in own.items()}
        for method in (name for name in methods if own[name]):
            last = [one for _, one in own[method]]
            at = {
                speed: [o.saved[objective][speed] for o in last if speed in o.saved.get(objective, {})]
                for speed in speeds
            }
            rows.append(
                [
                    method,
                    str(iteration),
                    f"{len(means[method])} × {len({line.seed for line, _ in own[method]})}",
                    *(show(float(np.median(values))) if values else NONE for values in at.values()),
                    show(float(np.mean([np.mean(list(seeds.values())) for seeds in means[method].values()]))),
                    f"{np.median([one.kl for one in last]):.1f}",
                    str(sum(one.falls for one in last)),
                    NONE if against in (None, method) else _difference(means[method], means[against or ""], unit),
                ]
            )
    head = ["method", "iteration", "realities × seeds", *(f"median, {speed} m/s" for speed in speeds)]
    return table([*head, "mean", "KL, nats, median", "falls", f"minus {against or 'another'}, mean, 95 %"], rows)


def _means(own: Sequence[tuple[ExactLine, Judged]], objective: str) -> dict[str, dict[int, float]]:
    found: dict[str, dict[int, float]] = {}
    for line, last in own:
        if last.saved.get(objective):
            found.setdefault(line.reality, {})[line.seed] = mean_of(last.saved[objective])
    return found


def _difference(means: Means, base: Means, unit: str) -> str:
    """In pairs by reality, of the seeds that both have there: a seed draws the same for both."""
    shared = {name: sorted(set(seeds) & set(base.get(name, {}))) for name, seeds in means.items()}
    shared = {name: seeds for name, seeds in shared.items() if seeds}
    if not shared:
        return NONE
    own, other = ({name: [v[name][seed] for seed in seeds] for name, seeds in shared.items()} for v in (means, base))
    return with_interval(paired(own, other), differences(unit))
