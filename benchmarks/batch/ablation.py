"""What each part is worth: `ours` without it, against `ours`, reality by reality.

An interval of one reality is of these runs on that machine: over seeds where both have two or more (Welch 1947,
Biometrika 34:28), else from the intervals of the two finals, which do not know what another seed would have found. The
interval of the mean is over realities (`hts.evaluation.population`) and is the one to go by.

A run whose final did not hold the speed is compared with the other's figures at equal commands: walking slower saves,
so a held and an open-loop figure are not of one kind.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from statistics import mean, variance

from scipy import stats

from batch.groups import Group, chosen, saving
from batch.lines import Result
from batch.tables import NONE, differences, more_refused, table, with_interval
from hts.errors import EvaluationError
from hts.evaluation.population import paired


def ablation(groups: Sequence[Group], against: str = "ours") -> str:
    """Rows: methods, each less the whole; columns: over realities, then each reality with its interval."""
    whole = next((group for group in groups if group.name == against), None)
    if whole is None:
        found = ", ".join(group.name for group in groups)
        raise EvaluationError(f"No line is of '{against}', which the others are held against. There are: {found}.")
    others = [group for group in groups if group is not whole and set(group.values()) & set(whole.values())]
    names = [name for name in whole.values() if any(name in group.values() for group in others)]
    show = differences(whole.unit)
    rows = []
    for group in others:
        kind = "chosen" if _held(group) == _held(whole) else "open_loop"
        ours, theirs = whole.values(kind=kind), group.values(kind=kind)
        gap = paired(theirs, ours)
        shared = {
            name: difference(group.on(name), whole.on(name), whole.objective, kind) for name in theirs if name in ours
        }
        rows.append(
            [
                group.name + (" (at equal commands)" if kind == "open_loop" else ""),
                with_interval(gap, show),
                f"{sum(one < 0 for one, _ in shared.values())} of {len(shared)}",
                more_refused(group, whole, shared, kind),
                *(_cell(group, *shared[name]) if name in shared else NONE for name in names),
            ]
        )
    head = ["method", f"minus {against}: mean over realities, 95 %", "worse on", "more speeds refused", *names]
    return table(head, rows)


def _held(group: Group) -> bool:
    """Whether its finals held the speed; where the pretrained policy stayed there is no final to ask."""
    outcomes = [
        result.objectives[group.objective] for _, result in group.results if group.objective in result.objectives
    ]
    return not outcomes or any(one.held is not None for one in outcomes)


def _cell(group: Group, gap: float, width: float | None) -> str:
    value, unit = differences(group.unit)(gap).rsplit(" ", 1)
    bounds = "" if width is None else f" ± {differences(group.unit, signed=False)(width).rsplit(' ', 1)[0]}"
    return f"{value}{bounds} {unit}"


def difference(
    first: Sequence[Result], second: Sequence[Result], objective: str, kind: str = "chosen"
) -> tuple[float, float | None]:
    """Mean saving of the first less the second on one reality, and half of its 95 % interval (None: nobody knows)."""
    values = [[saving(one, objective, kind=kind) for one in runs] for runs in (first, second)]
    gap = mean(values[0]) - mean(values[1])
    if all(len(one) > 1 for one in values):
        parts = [variance(one) / len(one) for one in values]
        total = sum(parts)
        if total == 0.0:
            return gap, 0.0
        degrees = total**2 / sum(p**2 / (len(one) - 1) for p, one in zip(parts, values, strict=True))
        return gap, float(stats.t.ppf(0.975, degrees)) * math.sqrt(total)
    widths = [_half_width(one, objective, kind) for runs in (first, second) for one in runs]
    if any(width is None for width in widths):
        return gap, None
    counts = [len(runs) for runs in (first, second) for _ in runs]
    squares = sum((float(width or 0.0) / count) ** 2 for width, count in zip(widths, counts, strict=True))
    return gap, math.sqrt(squares)


def _half_width(result: Result, objective: str, kind: str) -> float | None:
    """Of a run's saving: of the mean over the speeds asked for; a speed that was refused is surely 0."""
    squares = 0.0
    for one in chosen(result.objectives.get(objective), kind).values():
        if one.improvement_ci95 is None:
            return None
        squares += ((one.improvement_ci95[1] - one.improvement_ci95[0]) / 2) ** 2
    return math.sqrt(squares) / len(result.asked_speeds)
