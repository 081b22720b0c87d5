"""The front of two objectives: what was gained in both at once, in reality and in simulation."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

from hts.policy_ids import PRETRAINED
from hts.report import wording
from hts.report.data import Json, RunData
from hts.report.style import ACCENT, INK, MARKERS, REFERENCE, SOFT, figure, legend_mark, ramp

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

PAIR = tuple[float, float]


def front(run: RunData, pair: tuple[str, str]) -> Figure | None:
    """What was measured in two objectives, as it counts, the front of all tested policies;
    beside it the same in simulation."""
    tested = list(_tested(run, pair))
    if not tested:
        return None
    drawing, axes = figure(3.7, 1, 2, gridspec_kw={"width_ratios": [1.25, 1]})
    _measured(axes[0, 0], run, pair, tested)
    _simulated(axes[0, 1], run, pair)
    return drawing


def _tested(run: RunData, pair: tuple[str, str]) -> Iterator[tuple[Json, list[Json]]]:
    """(candidate, its results in both objectives) of everything that was measured."""
    for candidate in run.candidates:
        real = candidate.get("real") or {}
        if all(real.get(name) for name in pair):
            yield candidate, [next(iter(real[name].values())) for name in pair]


def counts(candidate: Json, objective: str, result: Json) -> tuple[float, Sequence[float] | None]:
    """What a candidate is compared by in an objective, and its 95 % interval: the improvement's or that of the metric
    which the objective counts instead (the smaller of two, say); None if it is neither."""
    improvement = result["improvement"]
    score = (candidate.get("selection_scores") or {}).get(objective)
    if score is None or math.isclose(score, improvement, rel_tol=1e-9):
        return improvement, result.get("improvement_ci95")
    intervals = result.get("metrics_ci95") or {}
    for name, value in (result.get("metrics") or {}).items():
        if value is not None and math.isclose(score, value, rel_tol=1e-9):
            return score, intervals.get(name)
    return score, None


def _measured(panel: Axes, run: RunData, pair: tuple[str, str], tested: Sequence[tuple[Json, list[Json]]]) -> None:
    factors = [wording.scale(run.unit(name)) for name in pair]
    on_front = {entry["id"] for entry in run.front}
    best = run.chosen
    _cross(panel)
    line: list[PAIR] = []
    for candidate, results in sorted(tested, key=lambda item: item[0]["id"] in on_front):
        place, bars = [], []
        for name, result, (factor, _) in zip(pair, results, factors, strict=True):
            counted, bounds = counts(candidate, name, result)
            value = factor * counted
            low, high = (factor * bound for bound in bounds) if bounds else (value, value)
            place.append(value)
            bars.append([[max(0.0, value - low)], [max(0.0, high - value)]])
        kept = candidate["id"] in on_front
        panel.errorbar(
            [place[0]],
            [place[1]],
            xerr=bars[0],
            yerr=bars[1],
            fmt="x" if candidate.get("fell") else "o",
            color=ACCENT if kept else REFERENCE,
            markersize=6 if kept else 4.5,
            capsize=0,
            linewidth=1.1,
            alpha=1.0 if kept else 0.75,
            zorder=4 if kept else 3,
        )
        if kept:
            line.append((place[0], place[1]))
            panel.annotate(
                candidate["id"],
                (place[0], place[1]),
                xytext=(5, 5),
                textcoords="offset points",
                fontsize=7.5,
                fontweight="bold" if candidate["id"] == best else "normal",
                color=INK,
                zorder=5,
            )
        if candidate["id"] == best:
            panel.plot([place[0]], [place[1]], "o", markersize=11, markerfacecolor="none", color=INK, zorder=5)
    if PRETRAINED in on_front:
        line.append((0.0, 0.0))
    if len(run.objectives) == 2:
        _stairs(panel, line, ACCENT)
    panel.plot([0], [0], marker="D", color=INK, markersize=6, zorder=4)
    panel.annotate("pretrained", (0, 0), xytext=(6, -10), textcoords="offset points", fontsize=7.5, color=INK)
    panel.set_xlabel(f"{pair[0]}: counts as, {factors[0][1]}")
    panel.set_ylabel(f"{pair[1]}: counts as, {factors[1][1]}")
    panel.set_title(wording.label(run.where))
    panel.margins(0.12)


def _simulated(panel: Axes, run: RunData, pair: tuple[str, str]) -> None:
    """Scores above those of the pretrained policy, by the measurement models of each iteration."""
    fronts = {int(entry["iteration"]): set(entry["ids"]) for entry in run.simulated_fronts}
    _cross(panel)
    rounds = [(int(iteration["index"]), iteration) for iteration in run.iterations]
    for position, (index, iteration) in enumerate(rounds):
        start = iteration.get("pretrained_sim_scores") or {}
        color, line = ramp(position, len(rounds)), []
        for candidate in iteration.get("candidates") or []:
            scores = candidate.get("sim_scores") or {}
            place = tuple(_difference(scores.get(name), start.get(name)) for name in pair)
            if not all(map(math.isfinite, place)):
                continue
            kept = candidate["id"] in fronts.get(index, ())
            walks = not candidate.get("falls") and candidate.get("tracked", True)
            panel.plot(
                [place[0]],
                [place[1]],
                marker=MARKERS[position % len(MARKERS)] if walks else "x",
                linestyle="none",
                color=color,
                markersize=6 if kept else 4.5,
                alpha=1.0 if kept else 0.45,
                zorder=3,
            )
            if candidate.get("elite"):
                panel.plot([place[0]], [place[1]], "o", markersize=10, markerfacecolor="none", color=SOFT, mew=0.7)
            if kept:
                line.append((place[0], place[1]))
        if PRETRAINED in fronts.get(index, ()):
            line.append((0.0, 0.0))
        if len(run.objectives) == 2:
            _stairs(panel, line, color)
    panel.plot([0], [0], marker="D", color=INK, markersize=6, zorder=4)
    panel.set_xlabel(f"{pair[0]}: score above pretrained")
    panel.set_ylabel(f"{pair[1]}: score above pretrained")
    panel.set_title("In simulation")
    panel.margins(0.12)
    panel.legend(handles=_legend(rounds), loc="upper left", bbox_to_anchor=(0.0, -0.2), ncols=2, columnspacing=1.0)


def _legend(rounds: Sequence[tuple[int, Json]]) -> list[Any]:
    marks = [
        legend_mark(f"iteration {index}", MARKERS[position % len(MARKERS)], ramp(position, len(rounds)))
        for position, (index, _) in enumerate(rounds)
    ]
    ring = legend_mark("elite", markersize=9, markerfacecolor="none")
    return [*marks, ring, legend_mark("fell or missed the speed", "x")]


def _stairs(panel: Axes, points: Sequence[PAIR], color: str) -> None:
    """The edge of what the front dominates: below and left of it is beaten by one of its points."""
    if len(points) > 1:
        panel.step(*zip(*sorted(points), strict=True), where="pre", color=color, linewidth=1.3, alpha=0.7, zorder=2)


def _cross(panel: Axes) -> None:
    """The pretrained policy's level in both."""
    panel.axhline(0.0, color=SOFT, linewidth=0.8, zorder=1)
    panel.axvline(0.0, color=SOFT, linewidth=0.8, zorder=1)


def _difference(value: float | None, start: float | None) -> float:
    return math.nan if value is None or start is None else value - start
