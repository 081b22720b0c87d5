"""Figures from lines: savings over realities, prediction, real samples, open loop beside held. SVG and PNG."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from statistics import mean
from typing import TYPE_CHECKING

import numpy as np

from batch.curve import median_curve, staircases
from batch.groups import Group
from batch.predictions import doubts, improvements, predicted
from hts.evaluation.population import population, quantile
from hts.report.style import ACCENT, MARKERS, RC, REFERENCE, SOFT, WARN, figure, zero_line
from hts.report.wording import scale

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

TAIL = 1.05
COLOURS = (ACCENT, WARN, "#3a5a98", "#7a4a8c", "#5b7f2b", SOFT)


def savings(groups: Sequence[Group]) -> Figure | None:
    """One dot per reality, the median as a bar."""
    there = [group for group in groups if group.values()]
    if not there:
        return None
    drawing, axes = figure(0.9 + 0.42 * len(there))
    panel, (factor, unit) = axes[0, 0], scale(there[0].unit)
    zero_line(panel, vertical=True)
    for row, group in enumerate(there):
        means = factor * np.array([mean(map(float, np.ravel(runs))) for runs in group.values().values()])
        offsets = 0.24 * (np.argsort(np.argsort(means)) % 5 - 2) / 2  # side by side where they would hide each other
        panel.plot(means, row + offsets, "o", color=_colour(row), markersize=4, alpha=0.65, markeredgewidth=0)
        middle = factor * population(group.values(), quantile(0.5)).estimate
        panel.plot([middle, middle], [row - 0.36, row + 0.36], color=_colour(row), linewidth=2.2)
    panel.set_yticks(range(len(there)), [group.name for group in there])
    panel.set_ylim(len(there) - 0.5, -0.5)
    panel.set_xlabel(f"saved, mean over speeds, {unit}; a dot is a reality, the bar their median")
    return drawing


def prediction(groups: Sequence[Group]) -> Figure | None:
    """Predicted against measured: improvements where runs told them, and what the model made of the logs."""
    drawing, axes = figure(3.2, columns=2)
    (left, right), (factor, unit), drawn = axes[0], scale(groups[0].unit), False
    for row, group in enumerate(groups):
        found = [pair for one in group.tried for pair in predicted(one, group.objective)]
        costs = [
            (pair.predicted / level, pair.measured / level)
            for _, result in group.results
            for model in result.models
            if model.objective == group.objective and model.pairs
            for level in [mean(pair.measured for pair in model.pairs)]
            for pair in model.pairs
        ]
        style = {"color": _colour(row), "marker": MARKERS[row % len(MARKERS)], "s": 12, "alpha": 0.6, "linewidths": 0}
        for panel, pairs, by in ((left, found, factor), (right, costs, 1.0)):
            if pairs:
                drawn = True
                panel.scatter(
                    *(by * np.array(values) for values in zip(*pairs, strict=True)), label=group.name, **style
                )
    if not drawn:
        return None
    left.set_title("Improvement")
    left.set_xlabel(f"predicted, {unit}")
    left.set_ylabel(f"measured, {unit}")
    right.set_title("Measured quantity, of its iteration's mean")
    right.set_xlabel("predicted from the log")
    right.set_ylabel("measured")
    for panel in (left, right):
        _diagonal(panel)
    told = max((left, right), key=lambda panel: len(panel.get_legend_handles_labels()[0]))  # not all have a model
    drawing.legend(*told.get_legend_handles_labels(), loc="outside lower center", ncols=len(groups))
    return drawing


def robot_time(groups: Sequence[Group]) -> Figure | None:
    """Saving over real samples: the median staircase of each method, and what the final found where runs ended."""
    drawing, axes = figure(2.9)
    panel, (factor, unit), drawn, ways = axes[0, 0], scale(groups[0].unit), False, set[bool]()
    for row, group in enumerate(groups):
        found = staircases(group)
        if not found:
            continue
        drawn = True
        ways |= {one.finally_measured for runs in found.values() for one in runs}
        samples, heights = median_curve(found)
        last = float(np.median([one.samples[-1] for runs in found.values() for one in runs]))
        end = population(group.values(), quantile(0.5)).estimate
        kept = samples <= max(last, samples[1])
        x = np.append(samples[kept], TAIL * last) / 1000  # a stretch behind the last step, so that its height shows
        y = factor * np.append(heights[kept], heights[kept][-1])
        panel.step(x, y, where="post", color=_colour(row), label=group.name, linewidth=1.6)
        panel.plot([last / 1000], [factor * end], "D", color=_colour(row), markerfacecolor="white", markersize=6)
    if not drawn:
        return None
    zero_line(panel)
    panel.set_xlim(left=0)
    how = "like the final" if ways == {True} else "when it was tried" if ways == {False} else "in two ways"
    panel.set_xlabel("real samples before the final, thousands (diamonds: what the final found)")
    panel.set_ylabel(f"saved, median, {unit}")
    panel.set_title(f"The best so far, measured {how}")
    panel.legend(loc="best")
    return drawing


def doubt(groups: Sequence[Group]) -> Figure | None:
    """Where models fail, and whether they knew: promises kept per reality; the error of a level against its doubt."""
    drawing, axes = figure(3.2, columns=2)
    (left, right), drawn = axes[0], False
    names = list(dict.fromkeys(name for group in groups for name in improvements(group)))
    factor, unit = scale(groups[0].unit)
    for row, group in enumerate(groups):
        found, offset = improvements(group), 0.6 * (row - (len(groups) - 1) / 2) / max(1, len(groups))
        for name, pairs in found.items():
            drawn = True
            at, (told, got) = names.index(name) + offset, factor * np.array(pairs).mean(axis=0)
            left.plot([told, got], [at, at], color=_colour(row), linewidth=0.9, zorder=2)
            left.plot([told], [at], "o", color=_colour(row), markerfacecolor="white", markersize=3.5, zorder=3)
            left.plot([got], [at], "o", color=_colour(row), markersize=3.5, zorder=3)
        own = [one for each in doubts(group).values() for one in each]
        if own:
            drawn = True
            x, y = (100 * np.array(values) for values in ([o.spread for o in own], [abs(o.error) for o in own]))
            right.scatter(x, y, s=12, alpha=0.6, color=_colour(row), linewidths=0, label=group.name)
    if not drawn:
        return None
    zero_line(left, vertical=True)
    left.set_yticks(range(len(names)), names)
    left.tick_params(axis="y", labelsize=6.5)
    left.set_ylim(len(names) - 0.5, -0.5)
    left.set_title("Promised (open) and measured (full)")
    left.set_xlabel(f"improvement, mean over what was tried, {unit}")
    right.set_title("Error of a level against its doubt")
    right.set_xlabel("standard deviation by the model, % of the level")
    right.set_ylabel("error of the mean, % of the level")
    for row, group in enumerate(groups):
        left.plot([], [], "o", color=_colour(row), markersize=3.5, label=group.name)
    drawing.legend(*left.get_legend_handles_labels(), loc="outside lower center", ncols=len(groups))
    limit = max(right.get_xlim()[1], 1e-6)
    for times, style in ((1, "-"), (2, "--")):
        label = f"{times} standard deviation{'s' if times > 1 else ''}"
        right.plot([0, limit], [0, times * limit], style, color=REFERENCE, linewidth=0.9, zorder=1, label=label)
    right.set_xlim(0, limit)
    right.set_ylim(bottom=0)
    right.legend(loc="upper left")
    return drawing


def open_loop(groups: Sequence[Group]) -> Figure | None:
    """Open loop against held, a dot per run and speed."""
    drawing, axes = figure(3.2)
    panel, (factor, unit), drawn = axes[0, 0], scale(groups[0].unit), False
    for row, group in enumerate(groups):
        outcomes = [result.objectives.get(group.objective) for _, result in group.results]
        pairs = [
            (factor * one.open_loop[speed].improvement, factor * held.improvement)
            for one in outcomes
            if one is not None and one.held and one.open_loop
            for speed, held in one.held.items()
            if speed in one.open_loop
        ]
        if pairs:
            drawn = True
            x, y = zip(*pairs, strict=True)
            panel.scatter(x, y, s=12, alpha=0.6, color=_colour(row), label=group.name, linewidths=0)
    if not drawn:
        return None
    _diagonal(panel)
    panel.set_xlabel(f"open loop, {unit}")
    panel.set_ylabel(f"speed held, {unit}")
    panel.legend(loc="upper left")
    return drawing


FIGURES: dict[str, Callable[[Sequence[Group]], Figure | None]] = {
    "savings": savings,
    "prediction": prediction,
    "doubt": doubt,
    "robot-time": robot_time,
    "open-loop": open_loop,
}


def draw(groups: Sequence[Group], folder: Path, prefix: str) -> list[Path]:
    """PREFIX-NAME.svg and .png of every figure that has data; the same lines give the same SVG."""
    import matplotlib as mpl

    folder.mkdir(parents=True, exist_ok=True)
    made = []
    with mpl.rc_context(RC):
        for name, make in FIGURES.items():
            drawing = make(groups)
            if drawing is not None:
                path = folder / f"{prefix}-{name}"
                drawing.savefig(path.with_suffix(".svg"), metadata={"Date": None})
                drawing.savefig(path.with_suffix(".png"), dpi=150, metadata={"Software": None})
                made += [path.with_suffix(".svg"), path.with_suffix(".png")]
    return made


def _diagonal(panel: Axes) -> None:
    low, high = min(panel.get_xlim()[0], panel.get_ylim()[0]), max(panel.get_xlim()[1], panel.get_ylim()[1])
    panel.plot([low, high], [low, high], color=REFERENCE, linewidth=0.9, zorder=1)


def _colour(row: int) -> str:
    return COLOURS[row % len(COLOURS)]
