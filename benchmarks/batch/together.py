"""Versions of methods in one difference: batches that were registered to be looked at together.

A version is a method's options and commit. Each machine is compared within one version of both; only the differences
are put together, so what a version changed for both methods is in none of them.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from batch.groups import Group
from batch.tables import differences, noted, table, with_interval
from hts.errors import EvaluationError, unknown_name
from hts.evaluation.population import Population, paired, population, quantile

Differences = dict[str, list[float]]
"""Reality -> the difference of the means over seeds."""


def together(groups: Sequence[Group], against: str) -> str:
    """A row for each method and version, and one for all its versions: its saving less that of `against`, over the
    realities that both have in that version. Raises EvaluationError for a method that no line is of, where nothing is
    left to compare, and for a reality that two versions share: what a machine does would count twice."""
    versions: dict[str, dict[str, Group]] = {}
    for group in groups:
        first = group.lines[0]
        if versions.setdefault(first.method, {}).setdefault(first.commit, group) is not group:
            raise EvaluationError(f"Two sets of options are '{first.method}' at {first.commit[:7]}. Leave one out.")
    if against not in versions:
        raise EvaluationError(unknown_name("method in these lines", against, versions))
    rows = []
    for method, own in versions.items():
        shared = [commit for commit in own if commit in versions[against]]
        if method == against or not shared:
            continue
        every: Differences = {}
        for commit in shared:
            one, other = own[commit], versions[against][commit]
            found = _differences(one, other)
            if not found:
                continue
            again = sorted(set(found) & set(every))
            if again:
                raise EvaluationError(f"Two versions of '{method}' have been on {', '.join(again)}. Give lines of one.")
            every |= found
            rows.append(_row(f"{method}, {commit[:7]}", found, paired(one.values(), other.values()), one.unit))
        if every:
            rows.append(_row(f"{method}, all", every, population(every), next(iter(own.values())).unit))
    if not rows:
        raise EvaluationError(
            f"No method has been on a reality of '{against}' in the same version. Leave out --together."
        )
    head = ["method, version", "realities", f"minus {against}, mean, 95 %", "median, 95 %", "better on"]
    return noted(groups, table(head, rows))


def _differences(one: Group, other: Group) -> Differences:
    ours, theirs = one.values(), other.values()
    return {name: [float(np.mean(ours[name]) - np.mean(theirs[name]))] for name in ours if name in theirs}


def _row(label: str, found: Differences, whole: Population, unit: str) -> list[str]:
    show = differences(unit)
    each = [value for (value,) in found.values()]
    middle = population(found, quantile(0.5))
    better = f"{sum(value > 0 for value in each)} of {len(each)}"
    return [label, str(len(each)), with_interval(whole, show), with_interval(middle, show), better]
