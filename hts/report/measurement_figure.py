"""How well the measurement model predicts: over iterations, and policy by policy."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from hts.report.data import RunData
from hts.report.style import ACCENT, INK, REFERENCE, SOFT, figure
from hts.report.wording import label

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def measurement(run: RunData, objective: str) -> Figure | None:
    """Held-out R² and rank correlation of each iteration; predicted against measured mean per policy, if known. None
    where nothing of it is: one recording alone leaves none to hold out."""
    rows = [
        (int(iteration["index"]), (iteration.get("measurement_models") or {}).get(objective) or {})
        for iteration in run.iterations
    ]
    rows = [(index, model) for index, model in rows if model]
    if not rows:
        return None
    fits = {index: run.fit(index, objective) for index, _ in rows}
    latest = max((index for index in fits if policy_means(fits[index])), default=None)
    known = (value for _, model in rows for value in (model.get("held_out_r2"), model.get("rank_correlation")))
    if latest is None and all(value is None for value in known):
        return None
    drawing, axes = figure(2.95, 1, 1 if latest is None else 2)
    _quality(axes[0, 0], rows, [(index, proxy_r2(fits[index])) for index, _ in rows])
    if axes[0, 0].get_legend_handles_labels()[0]:  # none where nothing was held out
        drawing.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside lower left", ncols=3, columnspacing=1.2)
    if latest is not None:
        _predicted(axes[0, 1], latest, fits[latest])
    return drawing


def policy_means(fit: Mapping[str, Any]) -> list[tuple[float, float]]:
    """(predicted, measured) mean of the target per policy, from `held_out.policies` of a fit.json."""
    return [(float(p["predicted"]), float(p["measured"])) for p in (fit.get("held_out") or {}).get("policies") or []]


def proxy_r2(fit: Mapping[str, Any]) -> float | None:
    """Held-out R² of the objective's analytic stand-in, fitted as well as it can be; None if it has none."""
    proxy = (fit.get("held_out") or {}).get("proxy") or {}
    return (proxy.get("smoothed") or proxy).get("r2")


def _quality(panel: Axes, rows: list[tuple[int, Mapping[str, Any]]], proxy: list[tuple[int, float | None]]) -> None:
    for values, name, color, marker, size in (  # the first ones larger, since numbers may be the same
        ([(index, model.get("held_out_r2")) for index, model in rows], "held-out R²", ACCENT, "o", 8.0),
        (proxy, "R² of the analytic stand-in", REFERENCE, "s", 6.0),
        ([(index, model.get("rank_correlation")) for index, model in rows], "rank correlation", INK, "D", 4.0),
    ):
        found = [(index, value) for index, value in values if value is not None]
        if found:
            panel.plot(*zip(*found, strict=True), color=color, marker=marker, markersize=size, label=name)
    indices = [index for index, _ in rows]
    panel.set_xticks(indices)
    panel.set_xlim(min(indices) - 0.5, max(indices) + 0.5)
    low, _ = panel.get_ylim()
    panel.set_ylim(min(low, 0.0), 1.05)
    panel.axhline(1.0, color=SOFT, linewidth=0.9, zorder=1)
    panel.grid(axis="x", visible=False)
    panel.set_xlabel("iteration")
    panel.set_title("On recordings it never saw")


def _predicted(panel: Axes, index: int, fit: Mapping[str, Any]) -> None:
    points = policy_means(fit)
    unit = (fit.get("held_out") or {}).get("unit", "1")
    what = label(str(fit.get("target", "target"))) + ("" if unit == "1" else f", {unit}")
    values = [value for point in points for value in point]
    low, high = min(values), max(values)
    margin = 0.08 * (high - low or abs(high) or 1.0)
    ends = (low - margin, high + margin)
    panel.plot(ends, ends, color=SOFT, linewidth=0.9, zorder=1)
    panel.plot([m for _, m in points], [p for p, _ in points], "o", color=ACCENT, markeredgecolor=INK, markersize=5.5)
    panel.set_xlim(ends)
    panel.set_ylim(ends)
    panel.set_aspect("equal")
    panel.set_xlabel(f"{what}: measured mean")
    panel.set_ylabel("predicted mean")
    panel.set_title(f"Policy by policy, iteration {index}")
