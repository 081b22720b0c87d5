"""Lines put together: what each run saved, by method and reality. The rules that all tables share are here.

- A run's figure at a speed is the held one where the speed was held, else the open-loop one.
- Where the pretrained policy stayed the best, the run saved 0 at every speed.
- A speed that was refused counts as 0: nobody would use the policy there. How many were, is a column of its own.
- A run's saving is the mean over the speeds that were asked for. A failed run has none; it is counted.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from statistics import fmean
from typing import TypeVar

from batch.lines import Figures, GivenUp, Line, Outcome, Result, Tried
from batch.methods import ORACLE
from hts.errors import EvaluationError, unknown_name
from hts.evaluation.population import Values

T = TypeVar("T")


@dataclass(frozen=True)
class Group:
    """Runs of one method in one preset for one objective; name: the method, if need be with its version."""

    name: str
    objective: str
    unit: str
    lines: tuple[Line, ...]

    @property
    def results(self) -> list[tuple[Line, Result]]:
        """Of runs that ended well."""
        return [(line, line.result) for line in self.lines if line.result is not None]

    @property
    def speeds(self) -> list[str]:
        """That any run was asked for, slowest first."""
        return sorted({str(speed) for _, result in self.results for speed in result.asked_speeds}, key=float)

    @property
    def saw_inside(self) -> bool:
        """Whether these are runs of the oracle, which is no method."""
        return any(line.arguments[:1] == [ORACLE] for line in self.lines)

    def values(self, speed: str | None = None, kind: str = "chosen", metric: str | None = None) -> Values:
        """reality -> saving of each seed, at one speed (of the runs that were asked for it) or over all; metric: as of
        `saving`. Raises EvaluationError for a speed that no run was asked for."""
        if speed is not None and str(float(speed)) not in self.speeds and self.results:
            raise EvaluationError(unknown_name(f"speed of {self.name}, m/s,", speed, self.speeds))
        return self.by_reality(
            lambda result: (
                [saving(result, self.objective, speed, kind, metric)]
                if speed is None or float(speed) in result.asked_speeds
                else []
            )
        )

    def by_reality(self, told: Callable[[Result], Sequence[T]]) -> dict[str, list[T]]:
        """reality -> what is told of all runs on it; without those of which nothing is."""
        found: dict[str, list[T]] = {}
        for line, result in self.results:
            if own := told(result):
                found.setdefault(line.reality, []).extend(own)
        return found

    def on(self, reality: str) -> list[Result]:
        """Of its runs that ended well."""
        return [result for line, result in self.results if line.reality == reality]

    @property
    def tried(self) -> list[Tried]:
        """Candidates that were tried, of all runs."""
        return [one for _, result in self.results for one in result.tried]

    def figures(self) -> list[Figures]:
        """Every speed that was measured."""
        return [one for _, result in self.results for one in chosen(result.objectives.get(self.objective)).values()]

    def final_falls(self) -> int:
        """In all finals, held and at equal commands, at refused speeds and of policies that were given up too."""
        others = [given_up_falls(one) for _, result in self.results for one in result.given_up]
        outcomes = [result.objectives.get(self.objective) for _, result in self.results]
        return sum(others) + sum(falls_of(one) for one in outcomes if one is not None)

    def tried_falls(self) -> int:
        """Of candidates, before the final: in their trials, and in second ones where lines know of them."""
        return sum(max(one.falls, falls_told(one.why)) + (one.falls_again or 0) for one in self.tried)

    def count_refused(self, realities: Collection[str] | None = None, kind: str = "chosen") -> int:
        """Speeds that were refused, over all runs, or over those on the named realities; kind: as of `chosen`. Every
        speed of a run none of whose finals could be compared."""
        return sum(
            count_refused(result, self.objective, kind)
            for line, result in self.results
            if realities is None or line.reality in realities
        )

    def count_asked(self, realities: Collection[str]) -> int:
        """Speeds that were asked for, over all runs on the named realities that ended well."""
        return sum(len(result.asked_speeds) for line, result in self.results if line.reality in realities)


def chosen(outcome: Outcome | None, kind: str = "chosen") -> Mapping[str, Figures]:
    """Figures by speed: `held`, `open_loop`, or `chosen`: held where there are such."""
    if outcome is None:
        return {}
    if kind == "chosen":
        kind = "held" if outcome.held is not None else "open_loop"
    return (outcome.held if kind == "held" else outcome.open_loop) or {}


def refused(outcome: Outcome, kind: str = "chosen") -> Mapping[str, str]:
    """Why speeds were refused, of the figures that `chosen` gives."""
    return outcome.refused_open_loop if kind == "open_loop" and outcome.held is not None else outcome.refused


def count_refused(result: Result, objective: str, kind: str = "chosen") -> int:
    """Speeds that a run's final was refused at; all, where it had finals and none of them could be compared."""
    if objective in result.objectives:
        return len(refused(result.objectives[objective], kind))
    return len(result.asked_speeds) if result.given_up else 0


def given_up_falls(one: GivenUp) -> int:
    """In a final that was given up; lines of before counted those of held speeds alone."""
    told = [*(why for speeds in one.refused.values() for why in speeds.values()), one.error]
    return max(one.falls, sum(falls_told(why) for why in dict.fromkeys(told)))


def falls_of(outcome: Outcome) -> int:
    """In a final, held and at equal commands, at refused speeds too."""
    figures = [one for found in (outcome.held, outcome.open_loop) for one in (found or {}).values()]
    at_refused = (
        (outcome.refused, outcome.refused_falls),
        (outcome.refused_open_loop, outcome.refused_falls_open_loop),
    )
    return sum(one.falls for one in figures) + sum(
        max(counted.get(speed, 0), falls_told(reasons.get(speed)))
        for reasons, counted in at_refused
        for speed in reasons.keys() | counted.keys()
    )


def falls_told(why: str | None) -> int:
    """Of the policy, that a refusal speaks of; lines of before did not count them besides."""
    found = re.search(r"of the policy are valid .*with (\d+) falls", why or "")
    return int(found[1]) if found else 0


def saving(
    result: Result, objective: str, speed: str | None = None, kind: str = "chosen", metric: str | None = None
) -> float:
    """What a run saved at a speed, or on average over those asked for; see the rules above. metric: one of the
    objective's metrics instead of its improvement. Raises EvaluationError for a metric that it does not have, or a
    speed that was not asked for: only a speed that was, and was refused, counts as no saving."""
    figures, every = chosen(result.objectives.get(objective), kind), [str(one) for one in result.asked_speeds]
    speeds = every if speed is None else [str(float(speed))]
    if not set(speeds) <= set(every):
        raise EvaluationError(unknown_name("speed that this run was asked for, m/s,", str(speed), every))
    return fmean(_quantity(figures[one], metric) if one in figures else 0.0 for one in speeds)


def _quantity(figures: Figures, metric: str | None) -> float:
    if metric is None:
        return figures.improvement
    if metric not in figures.metrics:
        raise EvaluationError(unknown_name("metric in these lines", metric, figures.metrics))
    return figures.metrics[metric]


def groups_of(
    lines: Iterable[Line],
    preset: str | None = None,
    methods: Sequence[str] | None = None,
    objective: str | None = None,
    as_one: Collection[str] = (),
) -> list[Group]:
    """Groups in the order of `methods`, else of the lines. Raises EvaluationError where nothing is left, or where one
    group holds several presets or one run twice: those are not to be averaged.

    Versions of a method (other options, another commit) are groups of their own: `ours@1a2b3c4`, commit or options;
    but for the methods of `as_one`, whose versions the caller knows to do the same.
    """
    wanted = [
        line
        for line in lines
        if (preset is None or line.preset == preset)
        and (methods is None or line.method in methods)
        and (objective is None or objective in objectives_of(line))
    ]
    if not wanted:
        raise EvaluationError(
            f"No line has preset {preset or 'any'} and a method of {methods or 'any'}. Look at --lines."
        )
    presets = sorted({line.preset for line in wanted})
    if len(presets) > 1:
        raise EvaluationError(f"These lines are of presets {', '.join(presets)}. Name one: --preset {presets[0]}.")
    hashes: dict[str, str] = {}
    for line in wanted:
        if hashes.setdefault(line.reality, line.reality_hash) != line.reality_hash:
            raise EvaluationError(
                f"These lines have two realities named '{line.reality}', {hashes[line.reality][:12]} and "
                f"{line.reality_hash[:12]}. Give the newer file another name, or leave one's lines out."
            )
    name = objective or next((found for line in wanted for found in objectives_of(line)), "")
    others = sorted({" + ".join(objectives_of(line)) for line in wanted if name not in objectives_of(line)})
    if objective is None and others:
        raise EvaluationError(
            f"These lines are of objectives {name} and {', '.join(others)}, which have no common unit. Name one: "
            f"--objective {name}."
        )
    unit = next(
        (line.result.objectives[name].unit for line in wanted if line.result and name in line.result.objectives), "1"
    )
    for one in as_one:
        if one not in {line.method for line in wanted}:
            raise EvaluationError(unknown_name("method in these lines", one, sorted({line.method for line in wanted})))
    parted: dict[tuple[str, str, str], list[Line]] = {}
    for line in wanted:
        version = ("", "") if line.method in as_one else (line.method_hash, line.commit)
        rows = parted.setdefault((line.method, *version), [])
        if line.method in as_one and any(_twice(one, line) for one in rows):
            raise EvaluationError(
                f"{line.method} has two runs on {line.reality} at seed {line.seed}, of different versions, so they are "
                "not one. Leave one of the files of lines out."
            )
        rows.append(line)
    found = [
        Group(_name(key, list(parted)), name, unit, tuple(sorted(rows, key=lambda line: (line.reality, line.seed))))
        for key, rows in parted.items()
    ]
    order = list(methods) if methods else list(dict.fromkeys(line.method for line in wanted))
    return sorted(found, key=lambda group: order.index(group.lines[0].method))


def _twice(one: Line, other: Line) -> bool:
    """Whether both are results of the same thing; one that failed is counted beside the run that was made for it."""
    same = (one.reality, one.seed) == (other.reality, other.seed)
    return same and one.status == other.status == "done"


def objectives_of(line: Line) -> list[str]:
    """Of the run, from what was typed."""
    given = line.arguments
    return [value for option, value in pairwise(given) if option == "--objective"]


def _name(key: tuple[str, str, str], keys: Sequence[tuple[str, str, str]]) -> str:
    method, options, commit = key
    same = [one for one in keys if one[0] == method]
    if len(same) == 1:
        return method
    by_commit = len({one[2] for one in same}) == len(same)
    return f"{method}@{commit[:7]}" if by_commit else f"{method}@{commit[:7]}-{options[:4]}"
