"""One look for all figures: quiet axes, one accent colour, the same letters as the page."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

INK, SOFT, LINE = "#1f2933", "#5f6c7b", "#d5dbe1"
ACCENT, REFERENCE, WARN = "#0f6f78", "#9aa5b1", "#b4540a"
# Light to dark in one hue, so that order reads without a legend and in black and white.
RAMP = ("#8fc7c4", "#3f9aa0", "#0f6f78", "#0a4a55", "#062c36")
MARKERS = ("o", "D", "s", "^", "v", "P")
WIDTH = 7.2  # inches: the width of the page's text

RC: dict[str, Any] = {
    "font.family": "DejaVu Sans",  # comes with matplotlib: the same everywhere
    "font.size": 8.5,
    "axes.titlesize": 9,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.labelsize": 8.5,
    "axes.labelcolor": INK,
    "axes.edgecolor": SOFT,
    "axes.linewidth": 0.7,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": LINE,
    "grid.linewidth": 0.6,
    "text.color": INK,
    "xtick.color": SOFT,
    "ytick.color": SOFT,
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
    "xtick.labelsize": 8,
    "ytick.labelsize": 8,
    "legend.frameon": False,
    "legend.fontsize": 8,
    "legend.borderaxespad": 0.0,
    "lines.linewidth": 1.6,
    "svg.fonttype": "path",
    "svg.hashsalt": "hts",  # the same data give the same file
    "pdf.fonttype": 42,
    "figure.autolayout": False,  # `figure` names the layout; `save` takes it away again
    "figure.constrained_layout.use": False,
}


def figure(height: float, rows: int = 1, columns: int = 1, **options: Any) -> tuple[Figure, Any]:
    """A figure of the page's width and its axes (always an array [rows, columns]), free of any global state."""
    from matplotlib.figure import Figure

    drawing = Figure(figsize=(WIDTH, height), layout="constrained")
    return drawing, drawing.subplots(rows, columns, squeeze=False, **options)


def save(drawing: Figure, folder: Path, name: str) -> Path:
    """`name`.svg and `name`.pdf in the folder; returns the SVG's path. No date inside: same data, same bytes."""
    folder.mkdir(parents=True, exist_ok=True)
    drawing.savefig(folder / f"{name}.svg", metadata={"Date": None})
    drawing.set_layout_engine(None)  # the layout is found; finding it again for the PDF takes as long as drawing
    drawing.savefig(folder / f"{name}.pdf", metadata={"CreationDate": None, "ModDate": None})
    return folder / f"{name}.svg"


def embedded(drawing: Figure, folder: Path, file: str, title: str, caption: str, note: str) -> dict[str, str]:
    """`save`, and what the page needs to show it: title, caption, alt and the SVG as base64. note: a line in the
    figure's corner, which goes with it wherever it is shown."""
    if note:
        drawing.suptitle(note, x=0.005, ha="left", fontsize=7, fontweight="normal", color=SOFT)
    data = base64.b64encode(save(drawing, folder, file).read_bytes()).decode()
    alt = f"{title}{f', {note}' if note else ''}; described below"  # the caption is read out after it
    return {"title": title, "caption": caption, "alt": alt, "data": data}


def ramp(position: int, count: int) -> str:
    """Colour of the position-th of `count` ordered things, light to dark."""
    if count <= 1:
        return RAMP[2]
    return RAMP[round(position * (len(RAMP) - 1) / (count - 1))]


def legend_mark(label: str, marker: str = "o", color: str = SOFT, **look: Any) -> Line2D:
    """What stands in a legend for marks without a line."""
    from matplotlib.lines import Line2D

    return Line2D([], [], marker=marker, linestyle="none", color=color, label=label, **look)


def zero_line(axes: Axes, vertical: bool = False) -> None:
    """The reference policy: no improvement."""
    (axes.axvline if vertical else axes.axhline)(0.0, color=SOFT, linewidth=0.9, zorder=1)


def error_bar(axes: Axes, x: float, y: float, bounds: Sequence[float] | None, color: str, **options: Any) -> None:
    """A point with its interval, upright; without interval if there is none."""
    error = None if not bounds else [[max(0.0, y - bounds[0])], [max(0.0, bounds[1] - y)]]
    axes.errorbar([x], [y], yerr=error, color=color, **{"fmt": "o", "capsize": 3, "markersize": 5, **options})
