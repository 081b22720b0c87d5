"""Lines of coverage, and what they say: how often the interval of an evaluation holds the truth.

One line per policy × reality × repetition, and one per policy × reality with the truth. Evaluations of one reality
share its truth and its faults, so the interval of the pooled share is a cluster bootstrap over realities.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import Field
from scipy.stats import binomtest

from batch.coverage_sessions import student_of_sessions
from batch.lines import Part, parsed
from batch.tables import NONE, differences, table
from hts.errors import EvaluationError
from hts.evaluation.population import Population, population

Interval = tuple[float, float]


class Lengths(Part):
    """Of every session, s; `sessions`: how many of them."""

    sessions: int
    warmup: float
    trimming: float
    block: float


class Occasion(Part):
    """Some of an evaluation taken alone: one session (what `hts evaluate` says of a single head-to-head), say."""

    improvement: float
    improvement_ci95: Interval | None


class Counted(Part):
    """Of a truth: what the pieces say that a head-to-head would count, and their share of all."""

    improvement: float
    improvement_ci95: Interval | None
    valid: float
    reference_valid: float


class Found(Part):
    """At one speed. An evaluation: over its sessions; `as_one`: the same pieces, as if all blocks were of one session;
    `every_second`: whatever the speed of a piece was, not in lines of before it was there.
    A truth: `improvement_ci95` is its own uncertainty."""

    improvement: float
    improvement_ci95: Interval | None
    as_one: Interval | None = None
    every_second: Occasion | None = None
    occasions: list[Occasion] = Field(default_factory=list)
    mean_speed: float
    reference_speed: float
    falls: int = 0
    at_limit: int = Field(0, description="of a truth: sessions whose command reached the end of its range")
    counted: Counted | None = Field(None, description="of a truth, since there is one")


class CoverageLine(Part):
    """repetition: none, it is the truth."""

    version: Literal[1] = 1
    kind: Literal["truth", "evaluation"]
    key: str
    objective: str
    unit: str
    policy: str
    policy_hash: str
    reference_hash: str
    reality: str
    reality_hash: str
    repetition: int | None = None
    lengths: Lengths
    commit: str
    speeds: dict[str, Found]
    refused: dict[str, str] = Field(default_factory=dict)
    seconds: float

    @property
    def pair(self) -> tuple[str, str, str, str]:
        """What its truth is the truth of."""
        return (self.objective, self.policy_hash, self.reference_hash, self.reality_hash)


def read_coverage(paths: Iterable[Path]) -> list[CoverageLine]:
    """Lines, a later one of a key in place of an earlier one. Raises RunError naming file and line."""
    expected = "version 1, as benchmarks/realities.py coverage run writes it"
    return list({line.key: line for line in parsed(paths, CoverageLine, expected)}.values())


KINDS: dict[str, Callable[[Found], list[tuple[float, Interval | None]]]] = {
    "sessions as units": lambda found: [(found.improvement, found.improvement_ci95)],
    "sessions as units, every second": lambda found: [
        (one.improvement, one.improvement_ci95) for one in [found.every_second] if one is not None
    ],
    "blocks as units, sessions pooled": lambda found: [(found.improvement, found.as_one)],
    "one session alone": lambda found: [(one.improvement, one.improvement_ci95) for one in found.occasions],
}
"""Intervals of one evaluation at one speed. The first is the one that is reported; the others say why."""


SAME_PAIRS = "all, of the pairs in the next row"

Against = Literal["all", "counted", "uncertain"]
"""A truth as it is held against intervals: of all pieces; of those that an evaluation counts; of all pieces, known no
better than its own sessions tell."""


def truths_of(lines: Sequence[CoverageLine]) -> dict[tuple[str, str, str, str], CoverageLine]:
    """The truth of each pair: of several the one with the most speeds, of equals the last. Raises EvaluationError where
    each of two has a speed that the other lacks."""
    found: dict[tuple[str, str, str, str], CoverageLine] = {}
    for line in lines:
        if line.kind != "truth":
            continue
        other = found.get(line.pair, line)
        if other.speeds.keys() <= line.speeds.keys():
            found[line.pair] = line
        elif not line.speeds.keys() < other.speeds.keys():
            raise EvaluationError(
                f"Two truths of {line.policy} on {line.reality} are at {', '.join(other.speeds)} and at "
                f"{', '.join(line.speeds)} m/s: neither is the whole. Make one at all of them (`coverage run --only "
                "truths --speeds`), or leave one's lines out."
            )
    return found


def _partial(lines: Sequence[CoverageLine]) -> list[CoverageLine]:
    """Truths with fewer speeds than another of their pair."""
    truths = truths_of(lines)
    return [one for one in lines if one.kind == "truth" and len(one.speeds) < len(truths[one.pair].speeds)]


def coverage(
    lines: Sequence[CoverageLine],
    kind: str,
    speed: str | None = None,
    policy: str | None = None,
    against: Against = "all",
) -> dict[str, list[tuple[float, Interval, float]]]:
    """reality -> (estimate, interval, truth) of every evaluation there. Where truths are uncertain, the interval is
    that of the difference of the two. Raises EvaluationError without a truth."""
    truths = truths_of(lines)
    found: dict[str, list[tuple[float, Interval, float]]] = {}
    for line in lines:
        if line.kind == "truth" or policy not in (None, line.policy):
            continue
        if line.pair not in truths:
            raise EvaluationError(
                f"There are evaluations of {line.policy} on {line.reality} and no truth. Run `coverage run` to its end."
            )
        truth = truths[line.pair].speeds
        for key, one in line.speeds.items():
            whole = truth.get(key) if speed in (None, key) else None
            true = whole.counted if whole and against == "counted" else whole
            if true is not None:
                own = _half(true.improvement_ci95) if against == "uncertain" else 0.0
                kept = [
                    (value, _widened(value, ci, own), true.improvement)
                    for value, ci in KINDS[kind](one)
                    if ci is not None
                ]
                found.setdefault(line.reality, []).extend(kept)
    return {reality: rows for reality, rows in found.items() if rows}


def share(rows: dict[str, list[tuple[float, Interval, float]]]) -> Population:
    """Of the intervals that hold the truth, realities as clusters; each evaluation counts alike where all realities
    have equally many."""
    return population(
        {name: [float(low <= truth <= high) for _, (low, high), truth in each] for name, each in rows.items()}
    )


def share_interval(rows: dict[str, list[tuple[float, Interval, float]]]) -> Interval | None:
    """95 % of `share`: over realities, and no narrower than so many intervals say if realities were alike (Clopper and
    Pearson 1934). A few realities that agree, all intervals of which hold the truth say, would have none at all. None
    with one reality."""
    over_realities = share(rows).interval
    if over_realities is None:
        return None
    holds = [low <= truth <= high for each in rows.values() for _, (low, high), truth in each]
    alike = binomtest(sum(holds), len(holds)).proportion_ci(0.95, method="exact")
    return min(over_realities[0], float(alike.low)), max(over_realities[1], float(alike.high))


def coverage_table(lines: Sequence[CoverageLine]) -> str:
    """Pooled, then by speed and by policy: share that holds the truth, with its interval over realities; mean half
    width; root mean square and mean of estimate less truth. Once more with the truth's own uncertainty and, where
    truths know it, against the truth of the pieces that an evaluation counts, and beside it the same pairs against all
    pieces where not all truths know it. Below, what Student's interval would hold of those very sessions."""
    evaluations = [line for line in lines if line.kind == "evaluation"]
    if not evaluations:
        raise EvaluationError("No line is an evaluation. Make some: benchmarks/realities.py coverage run.")
    units = {(line.objective, line.unit) for line in evaluations}
    if len(units) > 1:
        names = ", ".join(sorted(name for name, _ in units))
        raise EvaluationError(f"These lines are of several objectives ({names}). Name files of one with --lines.")
    partial = _partial(lines)
    lines = [line for line in lines if line not in partial]
    show = differences(next(iter(units))[1], signed=False)
    signed = differences(next(iter(units))[1])
    speeds = sorted({key for line in evaluations for key in line.speeds}, key=float)
    policies = sorted({line.policy for line in evaluations})
    first = next(iter(KINDS))
    both = _with_both_truths(lines)
    cuts: list[tuple[str, str, str | None, str | None, Against]] = [(first, "all", None, None, "all")]
    cuts += [(first, "all, of truths as uncertain as they are", None, None, "uncertain")]
    cuts += [(first, SAME_PAIRS, None, None, "all")] if len(both) < len(lines) else []
    cuts += [(first, "all, against the pieces that it counts", None, None, "counted")]
    cuts += [(kind, "all", None, None, "all") for kind in KINDS if kind != first]
    cuts += [(first, f"{speed} m/s", speed, None, "all") for speed in speeds if len(speeds) > 1]
    cuts += [(first, policy, None, policy, "all") for policy in policies if len(policies) > 1]
    rows = []
    for kind, what, speed, policy, against in cuts:
        found = coverage(both if what == SAME_PAIRS else lines, kind, speed, policy, against)
        if not found:
            continue
        every = [row for each in found.values() for row in each]
        held, errors = share(found), np.array([estimate - truth for estimate, _, truth in every])
        half = float(np.mean([(high - low) / 2 for _, (low, high), _ in every]))
        ends = share_interval(found)
        between = "one reality" if ends is None else f"{_percent(ends[0])} to {_percent(ends[1])}"
        rows.append(
            [
                kind,
                what,
                f"{held.realities}",
                f"{len(every)}",
                f"{_percent(held.estimate)} % ({between})",
                show(half),
                show(float(np.sqrt((errors**2).mean()))),
                signed(float(errors.mean())),
            ]
        )
    refused = sum(len(line.refused) for line in evaluations)
    head = ["interval", "of", "realities", "intervals", "hold the truth (over realities)", "half width, mean"]
    head += ["error, RMS", "error, mean"]
    sessions = sorted({line.lengths.sessions for line in evaluations})
    note = f"{', '.join(map(str, sessions))} sessions an evaluation; {refused} speeds refused"
    if partial:
        note += f"; truths left out, as another of their pair has more speeds: {len(partial)}"
    more = _misses(coverage(lines, first)) + _left_out(lines, signed, show) + _resampled(evaluations)
    return f"{table(head, rows)}\n\n{note}; truths to within {_truth_error(lines, show)} (95 %, mean).{more}"


def pairs_table(lines: Sequence[CoverageLine]) -> str:
    """Each policy on each reality: the truth, and what evaluations of it said."""
    rows, partial = [], _partial(lines)
    truths = [line for line in lines if line.kind == "truth" and line not in partial]
    for truth in sorted(truths, key=lambda line: (line.policy, line.reality)):
        mine = [line for line in lines if line.kind == "evaluation" and line.pair == truth.pair]
        show = differences(truth.unit, signed=False)
        for speed, one in sorted(truth.speeds.items(), key=lambda item: float(item[0])):
            said = [line.speeds[speed] for line in mine if speed in line.speeds]
            intervals = [each.improvement_ci95 for each in said if each.improvement_ci95 is not None]
            holds = sum(low <= one.improvement <= high for low, high in intervals)
            rows.append(
                [
                    truth.policy,
                    truth.reality,
                    speed,
                    show(one.improvement),
                    show(float(np.mean([each.improvement for each in said]))) if said else NONE,
                    show(float(np.std([each.improvement for each in said], ddof=1))) if len(said) > 1 else NONE,
                    f"{holds} of {len(intervals)}",
                ]
            )
    head = ["policy", "reality", "m/s", "truth", "evaluations: mean", "their standard deviation", "hold the truth"]
    return table(head, rows)


def _half(interval: Interval | None) -> float:
    return 0.0 if interval is None else (interval[1] - interval[0]) / 2


def _widened(value: float, interval: Interval, other: float) -> Interval:
    """Each end as far from the value as the root of the sum of the squares of its own distance and another half width:
    of a difference of two independent estimates."""
    low, high = interval
    return value - float(np.hypot(value - low, other)), value + float(np.hypot(high - value, other))


def _misses(found: dict[str, list[tuple[float, Interval, float]]]) -> str:
    """On which side they lie."""
    every = [row for each in found.values() for row in each]
    above, below = sum(low > truth for _, (low, _), truth in every), sum(high < truth for _, (_, high), truth in every)
    return f" Of the intervals over sessions {above} lie above the truth and {below} below it."


def _resampled(evaluations: Sequence[CoverageLine]) -> str:
    found = student_of_sessions(evaluations)
    if found is None:
        return ""
    return (
        " Of as many sessions as an evaluation has, drawn again and again from all that were seen of a pair, Student's "
        f"interval holds the mean of these all in {_percent(1 - found.above - found.below)} %, lies above it in "
        f"{_percent(found.above)} and below it in {_percent(found.below)} % ({found.pairs} pairs, each alike): more "
        "than that, this kind of interval cannot hold here."
    )


def _truth_error(lines: Sequence[CoverageLine], show: Callable[[float], str]) -> str:
    widths = [
        _half(one.improvement_ci95)
        for line in lines
        if line.kind == "truth"
        for one in line.speeds.values()
        if one.improvement_ci95 is not None
    ]
    return "±" + show(float(np.mean(widths))) if widths else NONE


def _with_both_truths(lines: Sequence[CoverageLine]) -> list[CoverageLine]:
    """Those of pairs whose truth tells of the counted pieces too: only on the same pairs are the two comparable."""
    known = {line.pair for line in lines if line.kind == "truth" and any(one.counted for one in line.speeds.values())}
    return [line for line in lines if line.pair in known]


def _left_out(lines: Sequence[CoverageLine], signed: Callable[[float], str], show: Callable[[float], str]) -> str:
    """What counting only the pieces near the asked speed does to a truth: empty where no truth knows."""
    truths = [one for line in lines if line.kind == "truth" for one in line.speeds.values()]
    more = [one.counted.improvement - one.improvement for one in truths if one.counted is not None]
    if not more:
        return ""
    largest = max(more, key=abs)
    return (
        f" Of {len(more)} truths the pieces near the asked speed say {signed(float(np.mean(more)))} in the mean "
        f"against all pieces, {show(float(np.median(np.abs(more))))} without sign in the median, {signed(largest)} at "
        "most."
    )


def _percent(value: float) -> str:
    return f"{100 * min(max(value, 0.0), 1.0):.1f}"
