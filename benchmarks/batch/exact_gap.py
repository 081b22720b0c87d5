"""Where promises are lost: the model's error, and what simulated walks are not."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from batch.exact_lines import ExactLine, Judged
from batch.groups import Group
from batch.lines import Line, Tried
from batch.tables import differences, noted, shown, table, with_interval
from hts.errors import EvaluationError
from hts.evaluation.population import population

Triple = tuple[float, float, float]
"""Promised, by the instruments in the same simulated walks, and measured in the trial: of a policy at a speed."""
Found = dict[str, list[Triple]]
"""By reality."""

HEAD = [
    "method",
    "iteration",
    "policies on realities",
    "promised",
    "by the instruments, in the same simulated walks",
    "measured in the trial",
    "the model: promised less instruments, 95 %",
    "RMS",
    "the walks: measured less instruments, 95 %",
    "RMS",
]


def gap_table(groups: Sequence[Group], exact: Sequence[ExactLine]) -> str:
    """A row for each method and iteration, and one for all iterations. Means are over policies and speeds in a reality,
    then over realities. Below it what is not in it, and whether some walks were others than those of the run. Raises
    EvaluationError where no run has both."""
    judged: dict[tuple[str, str, int, str], dict[str, Judged]] = {}
    for again in exact:
        for one in again.result.candidates if again.result is not None else ():
            judged.setdefault(_run(again), {})[one.id] = one
    rows, missing = [], 0
    for group in groups:
        found: dict[int | None, Found] = {}
        policies: dict[int | None, int] = {}
        for line, result in group.results:
            known = judged.get(_run(line), {})
            for tried in result.tried if known else ():
                if tried.refused:
                    continue
                missing += tried.id not in known
                triples = _triples(tried, known[tried.id], group.objective) if tried.id in known else []
                for iteration in (tried.iteration, None) if triples else ():
                    found.setdefault(iteration, {}).setdefault(line.reality, []).extend(triples)
                    policies[iteration] = policies.get(iteration, 0) + 1
        for iteration in sorted(found, key=lambda each: (each is None, each or 0)):
            name = "all" if iteration is None else str(iteration)
            rows.append([group.name, name, *_row(found[iteration], policies[iteration], group.unit)])
    if not rows:
        raise EvaluationError(
            "No policy that was tried in these runs was judged as well. Make: realities.py exact kept."
        )
    return noted(groups, "\n\n".join([table(HEAD, rows), *_notes(missing, groups, exact)]))


def _notes(missing: int, groups: Sequence[Group], exact: Sequence[ExactLine]) -> list[str]:
    runs = {_run(line) for group in groups for line in group.lines}
    here = [line.result for line in exact if line.result is not None and _run(line) in runs]
    others = sum(found.same_walks is False for found in here)
    unknown = sum(found.same_walks is None for found in here)
    said = []
    if missing:
        said.append(f"{missing} more that were tried are no candidates as training left them, and were not judged.")
    if others:
        said.append(f"In {others} of {len(here)} iterations the walks were others than those that the run had judged.")
    if unknown:
        said.append(f"Of {unknown} of {len(here)} iterations it is not known whether the walks were the run's.")
    return said


def _run(line: Line | ExactLine) -> tuple[str, str, int, str]:
    return line.method_hash, line.reality_hash, line.seed, line.commit


def _triples(one: Tried, again: Judged, objective: str) -> list[Triple]:
    told, saved = (one.predicted or {}).get(objective, {}), again.saved.get(objective, {})
    got: Mapping[str, float] = one.measured.get(objective, {})
    return [(told[speed], saved[speed], got[speed]) for speed in told if speed in saved and speed in got]


def _row(found: Found, policies: int, unit: str) -> list[str]:
    show, signed = shown(unit), differences(unit)
    plain = differences(unit, signed=False)
    means = {name: np.mean(triples, axis=0) for name, triples in found.items()}
    columns = [{name: [float(mean[at])] for name, mean in means.items()} for at in range(3)]
    off = {name: [float(mean[0] - mean[1])] for name, mean in means.items()}
    lost = {name: [float(mean[2] - mean[1])] for name, mean in means.items()}
    every = np.array([triple for triples in found.values() for triple in triples])
    model, walks = every[:, 0] - every[:, 1], every[:, 2] - every[:, 1]
    return [
        f"{policies} on {len(found)}",
        *(show(population(column).estimate) for column in columns),
        with_interval(population(off), signed),
        plain(float(np.sqrt(np.mean(model**2)))),
        with_interval(population(lost), signed),
        plain(float(np.sqrt(np.mean(walks**2)))),
    ]
