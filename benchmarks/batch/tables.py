"""Markdown tables from lines. Every number in them is made here, by the rules of `groups`."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from statistics import mean, median

import numpy as np

from batch.groups import Group, chosen, saving
from batch.lines import CONFIRM, Result
from hts.errors import EvaluationError, unknown_name
from hts.evaluation.population import Population, Values, paired, population, quantile, spread
from hts.report.wording import scale

POINT = {"1": 0.01}
"""What "within one point" means in a unit; 1 in any other."""
NONE = "–"
EACH_KIND = {"chosen": "", "held": " at held speed", "open_loop": " at equal commands"}
"""What `groups.chosen` knows, and how a table says it."""


def methods(groups: Sequence[Group]) -> str:
    """Methods over realities: what they save, what goes wrong, what it takes."""
    speeds = _speeds(groups)
    head = ["method", "realities × runs", "failed"]
    head += [f"median, {speed} m/s" for speed in speeds]
    head += ["median", "mean, 95 %", "5th percentile", "lowest", "falls: final, tried", "speeds refused"]
    head += ["real samples, median", "within 1 point of the best other", "minus the best other, mean, 95 %"]
    return noted(groups, table(head, [_method(group, rivals(groups, group), speeds) for group in groups]))


def short(groups: Sequence[Group]) -> str:
    """The same in a few columns, each method less the first one on the realities they share."""
    first, rows = groups[0], []
    for group in groups:
        show, values = shown(group.unit), group.values()
        if not values:
            continue
        less, failed = NONE, failed_runs(group)
        if group is not first and set(values) & set(first.values()):
            less = with_interval(paired(values, first.values()), differences(group.unit))
        rows.append(
            [
                group.name,
                f"{len(values)} ({failed} run{'' if failed == 1 else 's'} failed)" if failed else str(len(values)),
                show(population(values, quantile(0.5)).estimate),
                with_interval(population(values), show),
                show(min(_mean_of(values, name) for name in values)),
                str(group.count_refused()),
                f"{group.final_falls()}, {group.tried_falls()}",
                less,
            ]
        )
    head = ["method", "machines", "median", "mean, 95 %", "lowest machine", "speeds refused", "falls: final, tried"]
    return noted(groups, table([*head, f"minus {first.name}, mean, 95 %"], rows))


def rivals(groups: Sequence[Group], group: Group) -> list[Group]:
    """The other methods. An oracle is none, and is measured against nobody."""
    return [] if group.saw_inside else [one for one in groups if one is not group and not one.saw_inside]


def noted(groups: Sequence[Group], text: str) -> str:
    """A table with what must be said below it."""
    seen = [f"`{group.name}`" for group in groups if group.saw_inside]
    return f"{text}\n\n{', '.join(seen)}: saw inside the reality; no method, and no rival here." if seen else text


def _method(group: Group, others: Sequence[Group], speeds: Sequence[str]) -> list[str]:
    show, values = shown(group.unit), group.values()
    failed = failed_runs(group)
    if not values:
        return [group.name, "0", str(failed), *[NONE] * (len(speeds) + 9)]
    whole, lowest = population(values), min(_mean_of(values, name) for name in values)
    within, less = _against_best(group, others)
    return [
        group.name,
        f"{whole.realities} × {whole.runs / whole.realities:.3g}",
        str(failed),
        *(
            show(population(group.values(speed), quantile(0.5)).estimate) if speed in group.speeds else NONE
            for speed in speeds
        ),
        show(population(values, quantile(0.5)).estimate),
        with_interval(whole, show),
        show(population(values, quantile(0.05)).estimate),
        show(lowest),
        f"{group.final_falls()}, {group.tried_falls()}",
        f"{group.count_refused()} of {sum(len(result.asked_speeds) for _, result in group.results)}{_given_up(group)}",
        samples_median(group),
        within,
        less,
    ]


def failed_runs(group: Group) -> int:
    """Runs that ended in an error: they saved nothing that anybody knows, and are in no mean."""
    return sum(line.status == "failed" for line in group.lines)


def _given_up(group: Group) -> str:
    """How many finals were given up for another policy's, where any was."""
    count = sum(len(result.given_up) for _, result in group.results)
    return f" ({count} final{'' if count == 1 else 's'} given up)" if count else ""


def _against_best(group: Group, others: Sequence[Group]) -> tuple[str, str]:
    """Share of realities not more than a point behind the best of the others there; and the mean difference to the one
    of them that is best on average over the realities they share."""
    ours, found = group.values(), [one for one in others if set(one.values()) & set(group.values())]
    if not found:
        return NONE, NONE
    theirs = [one.values() for one in found]
    shared = [name for name in ours if any(name in values for values in theirs)]
    point = POINT.get(group.unit, 1.0)
    near = sum(
        _mean_of(ours, name) >= max(_mean_of(values, name) for values in theirs if name in values) - point
        for name in shared
    )
    best = min(found, key=lambda one: paired(ours, one.values()).estimate)
    return f"{near} of {len(shared)}", (
        f"{with_interval(paired(ours, best.values()), differences(group.unit))} ({best.name})"
    )


def best_other(groups: Sequence[Group]) -> str:
    """Each method against the best of the others on each reality: harder than against any one of them."""
    rows = []
    for group in groups:
        ours, theirs = group.values(), [one.values() for one in rivals(groups, group)]
        best = {
            name: max(_mean_of(values, name) for values in theirs if name in values)
            for name in ours
            if any(name in values for values in theirs)
        }
        if not best:
            continue
        gaps = {name: [_mean_of(ours, name) - other] for name, other in best.items()}
        ratios = {name: [_mean_of(ours, name) / other] for name, other in best.items() if other > 0}
        show, point = differences(group.unit), POINT.get(group.unit, 1.0)
        rows.append(
            [
                group.name,
                str(len(best)),
                with_interval(population(gaps), show),
                with_interval(population(gaps, quantile(0.5)), show),
                ratio(population(ratios, quantile(0.5))) + f" on {len(ratios)}" if ratios else NONE,
                f"{sum(gap[0] >= -point for gap in gaps.values())} of {len(gaps)}",
            ]
        )
    head = ["method", "realities", "minus the best other there: mean, 95 %", "median, 95 %", "ratio: median, 95 %"]
    return noted(groups, table([*head, "within 1 point of it"], rows))


def pairs(groups: Sequence[Group], against: str, kind: str = "chosen") -> str:
    """Differences to one method, reality by reality: also the table of an ablation, where `against` is the whole.

    kind: which figures and refusals, as of `groups.chosen`. Raises EvaluationError for one that there is not.
    """
    if kind not in EACH_KIND:
        raise EvaluationError(unknown_name("kind of figures", kind, EACH_KIND))
    whole = next((group for group in groups if group.name == against), None)
    if whole is None:
        raise EvaluationError(f"No line is of '{against}'. There are: {', '.join(group.name for group in groups)}.")
    show = differences(whole.unit)
    rows = []
    for group in groups:
        ours, theirs = group.values(kind=kind), whole.values(kind=kind)
        if group is whole or not set(ours) & set(theirs):
            continue
        found = paired(ours, theirs)
        shared = [name for name in ours if name in theirs]
        each = [_mean_of(ours, name) - _mean_of(theirs, name) for name in shared]
        rows.append(
            [
                group.name,
                str(found.realities),
                with_interval(found, show),
                show(float(np.median(each))),
                f"{sum(value > 0 for value in each)} of {len(each)}",
                more_refused(group, whole, shared, kind),
            ]
        )
    minus = f"minus {against}{EACH_KIND[kind]}, mean, 95 %"
    head = ["method", "realities", minus, "median", "better on", "more speeds refused"]
    return noted(groups, table(head, rows))


def more_refused(group: Group, whole: Group, shared: Collection[str], kind: str = "chosen") -> str:
    """By how many speeds on the shared realities; where any were and one has more runs there, how many of how many."""
    counts = [one.count_refused(shared, kind) for one in (group, whole)]
    asked = [one.count_asked(shared) for one in (group, whole)]
    if asked[0] == asked[1] or not any(counts):
        return signed(counts[0] - counts[1])
    return f"{counts[0]} of {asked[0]}, {whole.name} {counts[1]} of {asked[1]}"


def realities(groups: Sequence[Group]) -> str:
    """Each reality and each method: mean over seeds of the saving over speeds, and the lowest speed."""
    names = sorted({name for group in groups for name in group.values()})
    show = shown(groups[0].unit)

    def cell(group: Group, name: str) -> str:
        if name not in group.values():
            return NONE
        at_speeds = [group.values(speed) for speed in group.speeds]
        lowest = min(_mean_of(values, name) for values in at_speeds if name in values)  # a version may be asked others
        return f"{show(_mean_of(group.values(), name))} (lowest speed {show(lowest)})"

    rows = [[n, *(cell(g, n) for g in groups)] for n in names]
    return noted(groups, table(["reality", *(group.name for group in groups)], rows))


def open_loop(groups: Sequence[Group]) -> str:
    """Held beside open loop: medians over realities, speed by speed, and by how much the policy walks another speed
    than its reference, of the runs in which that speed was not refused and of how many that is."""
    rows = []
    for group in groups:
        show = shown(group.unit)
        for speed in group.speeds:
            row = [group.name, speed]
            for kind in ("held", "open_loop"):
                there = [
                    chosen(result.objectives[group.objective], kind)
                    for _, result in group.results
                    if group.objective in result.objectives
                ]
                walked = [found[speed] for found in there if speed in found]
                slower = [one.mean_speed - one.reference_speed for one in walked if one.reference_speed is not None]
                row += [
                    show(population(group.values(speed, kind), quantile(0.5)).estimate) if walked else NONE,
                    f"{mean(slower):+.3f} ({len(slower)} of {len(there)})".replace("-", "−") if slower else NONE,
                ]
            rows.append(row)
    head = ["method", "speed, m/s", "held: median", "held: m/s against the reference, where not refused"]
    return table([*head, "open loop: median", "open loop: m/s against the reference, where not refused"], rows)


def samples(groups: Sequence[Group]) -> str:
    """Where the robot's time goes, and the computer's: medians over runs."""
    rows = []
    for group in groups:
        found = [result for _, result in group.results]
        if not found:
            continue
        selection = [_trials(one.real_samples) for one in found]
        rows.append(
            [
                group.name,
                *(f"{median(values):,.0f}" for values in (_stage(found, "collect"), selection, _stage(found, "final"))),
                f"{median(one.real_samples['total'] for one in found):,.0f}",
                f"{median(one.seconds['total'] for one in found) / 60:.1f}",
            ]
        )
    return table(["method", "first data", "selection", "final", "all real samples", "minutes of computing"], rows)


def gate(groups: Sequence[Group]) -> str:
    """How many of the policies that walked a machine would have been spared, by the gate (docs/safety.md)."""
    rows = []
    for group in groups:
        best = [result.best.gate for _, result in group.results if result.best is not None]
        tried = [one.gate for one in group.tried]
        rows.append([group.name, str(len(group.results)), *(_refused_of(asked) for asked in (best, tried))])
    return table(["method", "runs", "finals of who fails the gate", "elites that fail it"], rows)


def _refused_of(passed: Sequence[bool | None]) -> str:
    known = [one for one in passed if one is not None]
    return f"{known.count(False)} of {len(known)}" if known else NONE


def seeds(groups: Sequence[Group]) -> str:
    """Run by run: the saving at each speed, what was refused, and minutes of computing; the mean of each method's."""
    show, rows = shown(groups[0].unit), []
    speeds = _speeds(groups)
    written = lambda value: NONE if np.isnan(value) else show(float(value))
    for group in groups:
        runs = sorted(group.results, key=lambda one: (one[0].reality, one[0].seed))
        figures = [
            [
                saving(result, group.objective, speed) if float(speed) in result.asked_speeds else np.nan
                for speed in speeds
            ]
            for _, result in runs
        ]
        for (line, result), row in zip(runs, figures, strict=True):
            outcome = result.objectives.get(group.objective)
            refused = ", ".join(outcome.refused) if outcome is not None and outcome.refused else "none"
            minutes = f"{result.seconds['total'] / 60:.1f}"
            rows.append([group.name, line.reality, str(line.seed), *map(written, row), refused, minutes])
        if len(runs) > 1:
            means = [written(one) for one in np.mean(figures, axis=0)]
            rows.append([group.name, "**mean**", "", *(f"**{one}**" for one in means), "", ""])
    return table(["method", "reality", "seed", *(f"{one} m/s" for one in speeds), "refused", "minutes"], rows)


def variation(groups: Sequence[Group]) -> str:
    """How much of the scatter is the realities', how much the seeds'."""
    rows = []
    for group in groups:
        if len(group.values()) > 1:
            found, show = spread(group.values()), differences(group.unit, signed=False)
            rows.append([group.name, show(found.between), NONE if found.within is None else show(found.within)])
    return table(["method", "standard deviation between realities", "between seeds of one"], rows)


# ------------------------------------------------------------------------------------------------------ writing


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """As markdown."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(row) + " |" for row in lines)


def shown(unit: str) -> Callable[[float], str]:
    """A saving in its unit, with one decimal."""
    factor, name = scale(unit)
    return lambda value: f"{factor * value:.1f} {name}".replace("-", "−")


def differences(unit: str, signed: bool = True) -> Callable[[float], str]:
    """A difference of savings: percentage points where they are per cent."""
    factor, name = scale(unit)
    name = "points" if name == "%" else name
    return lambda value: (f"{factor * value:+.1f} {name}" if signed else f"{factor * value:.1f} {name}").replace(
        "-", "−"
    )


def with_interval(found: Population, show: Callable[[float], str]) -> str:
    """`estimate (low to high)`; the estimate alone where one reality says nothing of others."""
    if found.interval is None:
        return f"{show(found.estimate)} (one reality)"
    low, high = (show(value).rsplit(" ", 1)[0] for value in found.interval)
    return f"{show(found.estimate)} ({low} to {high})"


def ratio(found: Population) -> str:
    """`1.05 (0.97 to 1.20)`."""
    return with_interval(found, "{:.2f}".format)


def signed(count: int) -> str:
    """`+2` or `−2`."""
    return f"{count:+d}".replace("-", "−")


def number(value: float | None) -> str:
    """With two decimals."""
    return NONE if value is None else f"{value:.2f}".replace("-", "−")


def samples_median(group: Group) -> str:
    """Real samples of a run."""
    return f"{median(result.real_samples['total'] for _, result in group.results):,.0f}"


def _trials(by_stage: Mapping[str, int]) -> int:
    """Of all iterations, and those that confirm the best; lines of before do not name these, but count them in all."""
    tests = sum(value for stage, value in by_stage.items() if stage.endswith("/test"))
    named = sum(value for stage, value in by_stage.items() if stage != "total")
    return tests + by_stage.get(CONFIRM, by_stage["total"] - named)


def _stage(found: Sequence[Result], stage: str) -> list[int]:
    return [one.real_samples.get(stage, 0) for one in found]


def _speeds(groups: Sequence[Group]) -> list[str]:
    return sorted({speed for group in groups for speed in group.speeds}, key=float)


def _mean_of(values: Values, name: str) -> float:
    return mean(float(np.mean(run)) for run in values[name])


TABLES: dict[str, Callable[[Sequence[Group]], str]] = {
    "methods": methods,
    "short": short,
    "best-other": best_other,
    "realities": realities,
    "open-loop": open_loop,
    "samples": samples,
    "gate": gate,
    "seeds": seeds,
    "variation": variation,
}
"""By name; `pairs` and `ablation` take the method they are against besides."""
