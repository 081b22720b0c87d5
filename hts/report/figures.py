"""The figures of a report. Each takes the run and returns a matplotlib figure, or None where it has no data."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from hts.policy_ids import PRETRAINED
from hts.report import wording
from hts.report.data import Json, RunData
from hts.report.style import ACCENT, INK, MARKERS, REFERENCE, SOFT, error_bar, figure, legend_mark, ramp, zero_line

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


FEW_POINTS = 40
"""So many seconds of one policy need no see-through marks."""


def improvement(run: RunData, objective: str) -> Figure | None:
    """Improvement at each speed with its 95 % interval; the objective's other fractions beside it."""
    speeds = run.final.get(objective, {}).get("speeds") or {}
    if not speeds:
        return None
    factor, unit = wording.scale(run.unit(objective))
    drawing, axes = figure(2.7)
    panel = axes[0, 0]
    zero_line(panel)
    keys = sorted(speeds, key=float)
    names, _ = wording.metric_names(speeds)
    names = [name for name in names if name.endswith(wording.FRACTION_ENDINGS)] if unit == "%" else []
    step = 0.11
    for position, key in enumerate(keys):
        result = speeds[key]
        bounds = result.get("improvement_ci95")
        error_bar(
            panel,
            position - step * len(names) / 2,
            factor * result["improvement"],
            [factor * b for b in bounds] if bounds else None,
            ACCENT,
            label=None if position else "improvement, 95 % interval",
            markersize=6.5,
        )
        for offset, name in enumerate(names, start=1):
            value = (result.get("metrics") or {}).get(name)
            if value is not None:
                panel.plot(
                    [position - step * len(names) / 2 + step * offset],
                    [factor * value],
                    marker=MARKERS[offset % len(MARKERS)],
                    markersize=5,
                    markerfacecolor="white",
                    color=SOFT,
                    linestyle="none",
                    label=None if position else wording.label(name).lower(),
                )
    panel.set_xticks(range(len(keys)), [run.task.point(key) for key in keys])
    panel.set_xlim(-0.6, len(keys) - 0.4)
    panel.grid(axis="x", visible=False)
    panel.set_ylabel(f"against the pretrained policy, {unit}")
    _legend_beside(panel, "improvement")
    return drawing


def distribution(run: RunData, objective: str) -> Figure | None:
    """Every 1 s segment of the final head-to-head, by the first quantity the objective scores."""
    speeds = run.segments.get(objective) or {}
    if not speeds:
        return None
    keys = sorted(speeds, key=float)
    quantity = next(iter(speeds[keys[0]]["policy"]))
    own = (run.final.get(objective, {}).get("metric_units") or {}).get(quantity)
    fraction = own == wording.PERCENT or run.unit(objective) == wording.PERCENT
    drawing, axes = figure(2.6, 1, len(keys), sharey=True)
    rng = np.random.default_rng(0)
    every = [[np.asarray(speeds[key][role][quantity], dtype=float) for role in ("reference", "policy")] for key in keys]
    exponent = 0 if fraction else _exponent([values - groups[0].mean() for groups in every for values in groups])
    for panel, key, groups in zip(axes[0], keys, every, strict=True):
        centre = groups[0].mean()
        panel.axhline(1.0 if fraction else 0.0, color=SOFT, linewidth=0.9, zorder=1)
        for x, (values, color) in enumerate(zip(groups, (REFERENCE, ACCENT), strict=True)):
            shown = values / centre if fraction else (values - centre) / 10.0**exponent
            size, opaque = (7, 0.45) if len(shown) > FEW_POINTS else (16, 0.9)  # a few small pale ones are not seen
            jitter = rng.uniform(-0.2, 0.2, len(shown))
            panel.scatter(x + jitter, shown, s=size, color=color, alpha=opaque, linewidths=0)
            panel.plot([x - 0.3, x + 0.3], [shown.mean()] * 2, color=INK, linewidth=1.4)
        panel.set_xticks([0, 1], ["pretrained", "final"])
        panel.set_xlim(-0.6, 1.6)
        panel.grid(axis="x", visible=False)
        panel.set_title(run.task.at([key]).removeprefix(" at "))
    name = wording.label(quantity)
    unit = ", " + " ".join(filter(None, (f"1e{exponent}" if exponent else "", own))) if exponent or own else ""
    axes[0, 0].set_ylabel(f"{name} / pretrained mean" if fraction else f"{name} − pretrained mean{unit}")
    return drawing


def _exponent(values: list[np.ndarray]) -> int:
    """Of the ten that an axis leaves to its label: 0 where its numbers are short without. matplotlib would write it
    above the first of several panels, into its title."""
    largest = max((float(np.abs(one).max()) for one in values if one.size), default=0.0)
    exponent = math.floor(math.log10(largest)) if 0.0 < largest < math.inf else 0
    return exponent if not -3 <= exponent <= 4 else 0


def sweep(run: RunData, objective: str) -> Figure | None:
    """One row per iteration: all candidates in simulation, and the elites in reality."""
    rows = [iteration for iteration in run.iterations if iteration.get("candidates")]
    if not rows:
        return None
    factor, unit = wording.scale(run.unit(objective))
    elites = [len(list(run.tested(iteration, objective))) for iteration in rows]
    heights = [max(2.3, 0.9 + 0.22 * count) for count in elites]
    drawing, axes = figure(
        sum(heights) + 0.5, len(rows), 2, gridspec_kw={"height_ratios": heights, "width_ratios": [1.15, 1]}
    )
    styles = _styles(rows, objective)
    real = [result for iteration in rows for _, _, result in run.tested(iteration, objective)]
    edges = [
        factor * b for result in real for b in (result.get("improvement_ci95") or [result.get("improvement") or 0])
    ]
    for (left, right), iteration in zip(axes, rows, strict=True):
        _simulated(left, iteration, objective, styles)
        left.set_title(f"Iteration {iteration['index']}: in simulation")
        left.set_ylabel("score in simulation")
        _measured(right, run, iteration, objective, factor, styles)
        right.set_title(f"Elites {run.where}")
        if edges:
            margin = 0.06 * (max(*edges, 0.0) - min(*edges, 0.0) + 1e-9)
            right.set_xlim(min(*edges, 0.0) - margin, max(*edges, 0.0) + margin)
    axes[-1, 0].set_xlabel("KL to the anchor, nats")
    axes[-1, 1].set_xlabel(f"improvement, {unit}")
    drawing.legend(
        handles=_legend(styles, objective if len(run.objectives) > 1 else ""),
        loc="outside lower center",
        ncols=6,
        handletextpad=0.3,
        columnspacing=1.2,
    )
    return drawing


def iterations(run: RunData, objective: str) -> Figure | None:
    """Measured improvement over iterations: every elite, and the best of each, with a line for each speed."""
    points = [
        (int(iteration["index"]), candidate["id"] == iteration.get("best"), speed, result)
        for iteration in run.iterations
        for candidate, speed, result in run.tested(iteration, objective)
        if result.get("improvement") is not None
    ]
    if not points:
        return None
    factor, unit = wording.scale(run.unit(objective))
    drawing, axes = figure(2.6)
    panel = axes[0, 0]
    zero_line(panel)
    rng = np.random.default_rng(0)
    speeds = sorted({speed for _, _, speed, _ in points}, key=float)
    for position, speed in enumerate(speeds):
        marker = MARKERS[position % len(MARKERS)]
        at = f", {run.task.point(speed)}" if len(speeds) > 1 else ""
        others = [(index, result) for index, is_best, one, result in points if one == speed and not is_best]
        best = [(index, result) for index, is_best, one, result in points if one == speed and is_best]
        panel.plot(
            [index + rng.uniform(-0.09, 0.09) for index, _ in others],
            [factor * result["improvement"] for _, result in others],
            marker=marker,
            linestyle="none",
            color=REFERENCE,
            markersize=4.5,
            label=f"{'other elites' if best else 'elites'}{at}" if others else None,
        )
        color = ramp(position, len(speeds)) if len(speeds) > 1 else ACCENT
        panel.plot(
            [index for index, _ in best], [factor * result["improvement"] for _, result in best], color=color, zorder=2
        )
        for number, (index, result) in enumerate(best):
            bounds = result.get("improvement_ci95")
            error_bar(
                panel,
                index,
                factor * result["improvement"],
                [factor * b for b in bounds] if bounds else None,
                color,
                label=None if number else f"best of the iteration{at}",
                markersize=6.5,
                fmt=marker,
            )
    indices = sorted(int(iteration["index"]) for iteration in run.iterations)
    panel.set_xticks(indices)
    panel.set_xlim(indices[0] - 0.6, indices[-1] + 0.6)
    panel.grid(axis="x", visible=False)
    panel.set_xlabel("iteration")
    panel.set_ylabel(f"improvement, {unit}")
    _legend_beside(panel, "best")
    return drawing


@dataclass(frozen=True)
class _Styles:
    """How candidates are drawn: a colour for λ of this objective, a marker for the anchor."""

    colors: dict[float, str]
    markers: dict[str, str]
    legend: dict[str, str]
    """λ, in words -> colour."""

    def marker(self, candidate: Json) -> str:
        return self.markers[str(candidate["anchor"])]

    def color(self, candidate: Json, objective: str) -> str:
        return self.colors[candidate["weights"].get(objective, 0.0)]


def _styles(rows: list[Json], objective: str) -> _Styles:
    """Over all iterations. λ that follow each iteration's model (`Objective.weights_for`) are nearly the same in all of
    them, so where all have as many, the smallest of each have one colour, and so on."""
    found = [sorted({one["weights"].get(objective, 0.0) for one in row["candidates"]}) for row in rows]
    groups = [sorted(set(alike)) for alike in zip(*found, strict=False)]
    if len({len(row) for row in found}) > 1 or any(low[-1] >= high[0] for low, high in pairwise(groups)):
        groups = [[weight] for weight in sorted({weight for row in found for weight in row})]
    ramped = [ramp(position, len(groups)) for position in range(len(groups))]
    anchors = {str(one["anchor"]) for row in rows for one in row["candidates"]}
    ordered = sorted(anchors, key=lambda anchor: (anchor != PRETRAINED, anchor))
    return _Styles(
        colors={weight: color for color, group in zip(ramped, groups, strict=True) for weight in group},
        markers={anchor: MARKERS[position % len(MARKERS)] for position, anchor in enumerate(ordered)},
        legend={_span(group): color for color, group in zip(ramped, groups, strict=True)},
    )


def _span(group: list[float]) -> str:
    """0.5, or 3.15 to 3.2."""
    return " to ".join(dict.fromkeys(f"{weight:g}" for weight in (group[0], group[-1])))


def _simulated(panel: Axes, iteration: Json, objective: str, styles: _Styles) -> None:
    for bound in sorted({c["kl_bound"] for c in iteration["candidates"] if c["kl_bound"] is not None}):
        panel.axvline(bound, color=SOFT, linewidth=0.8, linestyle=(0, (3, 3)), zorder=1)
        panel.annotate(
            f"c {bound:g}",
            (bound, 0.0),
            xycoords=panel.get_xaxis_transform(),
            xytext=(2, 2),
            textcoords="offset points",
            color=SOFT,
            fontsize=7,
        )
    for candidate in iteration["candidates"]:
        score = (candidate.get("sim_scores") or {}).get(objective, candidate.get("sim_score"))
        if candidate.get("kl") is None or score is None:
            continue
        place = ([candidate["kl"]], [score])
        marker, color = styles.marker(candidate), styles.color(candidate, objective)
        if candidate.get("elite"):
            panel.plot(*place, marker=marker, markersize=10.5, markerfacecolor="none", color=INK, markeredgewidth=0.9)
        panel.plot(*place, marker=marker, markersize=6, color=color, linestyle="none")
        if candidate.get("falls"):
            panel.plot(*place, marker="x", markersize=6, color="white", markeredgewidth=1.2)
    distances = [c["kl"] for c in iteration["candidates"] if c.get("kl") is not None and c["kl"] > 0]
    if distances and max(distances) > 12 * min(distances):
        panel.set_xscale("log")
        panel.xaxis.set_major_formatter("{x:g}")
    panel.margins(x=0.1, y=0.15)


def _measured(panel: Axes, run: RunData, iteration: Json, objective: str, factor: float, styles: _Styles) -> None:
    tested = [
        (candidate, speed, result)
        for candidate, speed, result in run.tested(iteration, objective)
        if result.get("improvement") is not None
    ]
    tested.sort(key=lambda item: item[2]["improvement"])
    speeds = {speed for _, speed, _ in tested}
    zero_line(panel, vertical=True)
    names = []
    for row, (candidate, speed, result) in enumerate(tested):
        value = factor * result["improvement"]
        bounds = result.get("improvement_ci95")
        error = [[max(0, value - factor * bounds[0])], [max(0, factor * bounds[1] - value)]] if bounds else None
        panel.errorbar(
            [value],
            [row],
            xerr=error,
            fmt=styles.marker(candidate),
            color=styles.color(candidate, objective),
            capsize=2.5,
            markersize=5.5,
            linewidth=1.2,
        )
        name = _settings(candidate)
        if len({one["id"] for one, _, _ in tested if _settings(one) == name}) > 1:  # as of one training, on its way
            name = f"{candidate['id']} · {name}"
        names.append(name + (f" · {run.task.point(speed)}" if len(speeds) > 1 else ""))
    panel.set_yticks(range(len(tested)), names)
    panel.set_ylim(-0.7, max(len(tested) - 0.3, 0.7))
    panel.grid(axis="y", visible=False)
    for text, (candidate, _, _) in zip(panel.get_yticklabels(), tested, strict=True):
        if candidate["id"] == iteration.get("best"):
            text.set_fontweight("bold")
    if not tested:
        panel.text(0.5, 0.5, "none tested", transform=panel.transAxes, ha="center", color=SOFT)
        panel.set_xticks([])


def _settings(candidate: Json) -> str:
    """A candidate's λ and c, in words."""
    return f"λ {wording.weights(candidate['weights'])} · c {wording.bound(candidate['kl_bound'])}"


def _legend_beside(panel: Axes, first: str) -> None:
    """A legend to the right of a panel, what begins with `first` on top."""
    handles, labels = panel.get_legend_handles_labels()
    order = sorted(range(len(labels)), key=lambda index: not labels[index].startswith(first))
    panel.legend([handles[i] for i in order], [labels[i] for i in order], loc="center left", bbox_to_anchor=(1.01, 0.5))


def _legend(styles: _Styles, objective: str) -> list:
    colors = [legend_mark(f"λ {name} {objective}".rstrip(), color=color) for name, color in styles.legend.items()]
    anchors = [legend_mark(f"from {anchor}", marker) for anchor, marker in styles.markers.items()]
    return [*colors, *anchors, legend_mark("elite", color=INK, markersize=9, markerfacecolor="none")]
