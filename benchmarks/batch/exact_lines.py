"""Lines of candidates that the reality's own instruments judged, and what they say of methods."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np
from pydantic import Field

from batch.lines import Part, RunLine, latest
from batch.tables import NONE, differences, shown, table, with_interval
from hts.errors import EvaluationError, unknown_name
from hts.evaluation.final import speed_key
from hts.evaluation.population import paired


class Judged(Part):
    """A candidate. share: how much of its training it has behind it; stopped: why its training was; falls: instances
    that fell in judging; saved: objective -> speed -> improvement over the pretrained policy, in the objective's unit,
    of the pieces of those that did not fall; valid: speed -> share of the 1 s segments in which the task was done."""

    id: str
    share: float = 1.0
    stopped: str | None = None
    weights: dict[str, float]
    kl_bound: float | None
    kl: float
    falls: int
    saved: dict[str, dict[str, float]]
    valid: dict[str, float]

    def figures(self, objective: str, speeds: Sequence[str], needed: float) -> dict[str, float]:
        """Speed -> what it saves; 0 at one where nothing could be told or too little of the time was good."""
        saved = self.saved.get(objective, {})
        return {speed: saved.get(speed, 0.0) if self.valid.get(speed, 0.0) >= needed else 0.0 for speed in speeds}


class Exact(Part):
    """One iteration's candidates. units: of each objective's improvement; needed: share of good segments below which a
    speed counts nothing, that of the run's final; pull: m/s² at each of the speeds, where trials told it; same_walks:
    whether falls and good segments are those that the run itself found when it judged them, none where it never did, or
    in a line of before; seconds: of each stage, and of the judging."""

    iteration: int
    units: dict[str, str]
    speeds: list[float]
    needed: float
    candidates: list[Judged]
    pull: list[float] | None = None
    same_walks: bool | None = None
    seconds: dict[str, float] = Field(default_factory=dict)

    @property
    def ends(self) -> list[Judged]:
        """The candidates of the sweep as their training ended, without those that were kept on the way."""
        return [one for one in self.candidates if one.share == 1.0]


class ExactLine(RunLine):
    """A run until an iteration's candidates were trained."""

    result: Exact | None = None


def read_exact(paths: Iterable[Path]) -> list[ExactLine]:
    """As `batch.lines.read_lines`."""
    return latest(paths, ExactLine, "as benchmarks/realities.py exact run writes it")


Show = Callable[[float], str]
Row = tuple[str, int, int]
"""Label of a method, iteration, and which of the sweep's candidates."""
Means = dict[str, dict[int, float]]
"""Reality -> seed -> the mean over speeds of what a candidate saves."""


def exact_table(lines: Sequence[ExactLine], against: str | None = None, objective: str | None = None) -> str:
    """A row for each method, iteration and candidate of the sweep: each speed, the mean and, in pairs by reality and
    seed, the difference to one method. Raises EvaluationError for lines that cannot stand in one table, and for a
    method or an objective that none is of."""
    done = [(line, line.result) for line in lines if line.result is not None]
    if not done:
        raise EvaluationError("These lines hold no candidates that were judged. Make some: realities.py exact run.")
    _refuse_mixed(done)
    labels = _labels([line for line, _ in done])
    if against is not None and against not in labels.values():
        raise EvaluationError(unknown_name("method", against, list(labels.values())))
    known = list(dict.fromkeys(name for _, found in done for name in found.units))
    objective = objective or known[0]
    if objective not in known:
        raise EvaluationError(unknown_name("objective of these lines", objective, known))
    unit = next(found.units[objective] for _, found in done if objective in found.units)
    speeds = [speed_key(speed) for speed in sorted({speed for _, found in done for speed in found.speeds})]
    groups: dict[Row, list[tuple[ExactLine, Exact, Judged]]] = {}
    for line, found in done:
        for place, one in enumerate(found.ends if objective in found.units else ()):
            groups.setdefault((labels[_version(line)], found.iteration, place), []).append((line, found, one))
    several = {row[:2] for row in groups if row[2]}
    means = {row: _means(own, objective) for row, own in groups.items()}
    show = shown(unit)
    rows = []
    for row in sorted(groups, key=lambda key: (key[1], list(labels.values()).index(key[0]), key[2])):
        own, (name, iteration, place) = groups[row], row
        going = [(found, one) for _, found, one in own if one.stopped is None]
        figures = [one.figures(objective, [speed_key(at) for at in found.speeds], found.needed) for found, one in going]
        missed = sum(value == 0.0 for one in figures for value in one.values())
        base = means.get((against or "", iteration, place), {})
        rows.append(
            [
                f"{name}, {own[0][2].id}" if row[:2] in several else name,
                str(iteration),
                f"{len(own)} on {len({line.reality for line, _, _ in own})}",
                *(_median([one[speed] for one in figures if speed in one], show) for speed in speeds),
                _mean([value for seeds in means[row].values() for value in seeds.values()], show),
                f"{missed} of {sum(map(len, figures))}",
                str(len(own) - len(going)),
                _median([one.kl for _, one in going], "{:.1f}".format),
                _mean([float(one.falls) for _, one in going], "{:.1f}".format),
                NONE if against in (None, name) else _difference(means[row], base, unit),
            ]
        )
    head = ["method", "iteration", "runs on realities", *(f"median, {speed} m/s" for speed in speeds), "mean"]
    more = ["speeds missed", "stopped", "KL, nats, median", "falls, mean", f"minus {against or 'another'}, mean, 95 %"]
    failed = [f"failed: {line.method}, {line.reality}, seed {line.seed}: {line.error}" for line in lines if line.error]
    return "\n".join([table([*head, *more], rows), *([""] if failed else []), *failed])


def _refuse_mixed(done: Sequence[tuple[ExactLine, Exact]]) -> None:
    """One preset, one file behind each reality's name, and one set of options behind each method's."""
    lines = [line for line, _ in done]
    presets = list(dict.fromkeys(line.preset for line in lines))
    if len(presets) > 1:
        raise EvaluationError(f"These lines are of the presets {', '.join(presets)}. Give files of one.")
    files: dict[str, str] = {}
    for line in lines:
        if files.setdefault(line.reality, line.reality_hash) != line.reality_hash:
            raise EvaluationError(f"Two realities are named '{line.reality}' in these lines. Give files of one.")
    options: dict[tuple[str, str, int], str] = {}  # the hash has the iteration in it
    for line, found in done:
        if options.setdefault((line.method, line.commit, found.iteration), line.method_hash) != line.method_hash:
            raise EvaluationError(
                f"Two sets of options are named '{line.method}' in these lines. Give files of one, or name them apart."
            )


Version = tuple[str, str]


def _version(line: ExactLine) -> Version:
    return line.method, line.commit


def _labels(lines: Sequence[ExactLine]) -> dict[Version, str]:
    """A method's name, with the commit behind it where there are several."""
    versions = list(dict.fromkeys(_version(line) for line in lines))
    commits = {method: {one[1] for one in versions if one[0] == method} for method, _ in versions}
    return {one: one[0] if len(commits[one[0]]) == 1 else f"{one[0]}@{one[1][:7]}" for one in versions}


def _means(own: Sequence[tuple[ExactLine, Exact, Judged]], objective: str) -> Means:
    found: Means = {}
    for line, exact, one in own:
        if one.stopped is None:
            figures = one.figures(objective, [speed_key(speed) for speed in exact.speeds], exact.needed)
            found.setdefault(line.reality, {})[line.seed] = float(np.mean(list(figures.values())))
    return found


def _difference(means: Means, base: Mapping[str, Mapping[int, float]], unit: str) -> str:
    """In pairs by reality, of the seeds that both have there: a seed draws the same for both."""
    shared = {name: sorted(set(seeds) & set(base.get(name, {}))) for name, seeds in means.items()}
    shared = {name: seeds for name, seeds in shared.items() if seeds}
    if not shared:
        return NONE
    own, other = ({name: [v[name][seed] for seed in seeds] for name, seeds in shared.items()} for v in (means, base))
    pairs = sum(map(len, shared.values()))
    return f"{with_interval(paired(own, other), differences(unit))}, {pairs} pairs on {len(shared)}"


def _median(values: Sequence[float], show: Show) -> str:
    return show(float(np.median(values))) if values else NONE


def _mean(values: Sequence[float], show: Show) -> str:
    return show(float(np.mean(values))) if values else NONE
