"""Where promises are lost: the model's error, and what simulated walks are not."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from batch.exact_lines import ExactLine, Judged
from batch.lines import Line, Tried
from batch.tables import differences, shown, table, with_interval
from hts.errors import EvaluationError, unknown_name
from hts.evaluation.population import population

Triple = tuple[float, float, float]
"""Promised, by the instruments in the same simulated walks, and measured in the trial: of a policy at a speed."""
Found = dict[str, list[Triple]]
"""By reality."""


def gap_table(whole: Sequence[Line], exact: Sequence[ExactLine], objective: str | None = None) -> str:
    """A row for each method and iteration, and one for all iterations. Means are over policies and speeds in a reality,
    then over realities. Raises EvaluationError where no run has both, and for an objective that none is of."""
    units = {name: unit for line in exact if line.result for name, unit in line.result.units.items()}
    objective = objective or next(iter(units), None)
    if objective not in units:
        raise EvaluationError(unknown_name("objective of these lines", objective or "", units))
    judged = {
        (*_run(line), line.result.iteration, one.id): one
        for line in exact
        if line.result is not None
        for one in line.result.candidates
    }
    rows: dict[tuple[str, int | None], Found] = {}
    policies: dict[tuple[str, int | None], int] = {}
    for line in whole:
        for one in line.result.tried if line.result is not None else ():
            again = judged.get((*_run(line), one.iteration, one.id))
            triples = [] if again is None or one.refused else _triples(one, again, objective)
            for row in ((line.method, one.iteration), (line.method, None)) if triples else ():
                rows.setdefault(row, {}).setdefault(line.reality, []).extend(triples)
                policies[row] = policies.get(row, 0) + 1
    if not rows:
        raise EvaluationError(
            "No policy that was tried in these runs was judged as well. Make: realities.py exact kept."
        )
    order = {name: place for place, name in enumerate(dict.fromkeys(name for name, _ in rows))}
    ordered = sorted(rows, key=lambda row: (order[row[0]], row[1] is None, row[1] or 0))
    return table(HEAD, [_row(row, rows[row], policies[row], units[objective]) for row in ordered])


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


def _run(line: Line | ExactLine) -> tuple[str, str, int, str]:
    return line.method_hash, line.reality_hash, line.seed, line.commit


def _triples(one: Tried, again: Judged, objective: str) -> list[Triple]:
    told, saved = (one.predicted or {}).get(objective, {}), again.saved.get(objective, {})
    got: Mapping[str, float] = one.measured.get(objective, {})
    return [(told[speed], saved[speed], got[speed]) for speed in told if speed in saved and speed in got]


def _row(row: tuple[str, int | None], found: Found, policies: int, unit: str) -> list[str]:
    show, signed = shown(unit), differences(unit)
    plain = differences(unit, signed=False)
    means = {name: np.mean(triples, axis=0) for name, triples in found.items()}
    columns = [{name: [float(mean[at])] for name, mean in means.items()} for at in range(3)]
    off = {name: [float(mean[0] - mean[1])] for name, mean in means.items()}
    lost = {name: [float(mean[2] - mean[1])] for name, mean in means.items()}
    every = np.array([triple for triples in found.values() for triple in triples])
    model, walks = every[:, 0] - every[:, 1], every[:, 2] - every[:, 1]
    return [
        row[0],
        "all" if row[1] is None else str(row[1]),
        f"{policies} on {len(found)}",
        *(show(population(column).estimate) for column in columns),
        with_interval(population(off), signed),
        plain(float(np.sqrt(np.mean(model**2)))),
        with_interval(population(lost), signed),
        plain(float(np.sqrt(np.mean(walks**2)))),
    ]
