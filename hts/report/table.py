"""The table at the end of `hts run` and `hts evaluate`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from hts.report import wording

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table


def print_table(summary: Mapping[str, Any], console: Console | None = None) -> None:
    """Print the final head-to-head of a summary.json, one table per objective."""
    final = summary.get("final") or {}
    _print(final.get("objectives") or {}, f"{final.get('policy') or 'final'} policy against pretrained", console)


def print_evaluation(evaluation: Mapping[str, Any], console: Console | None = None) -> None:
    """Print an evaluation.json, one table per objective."""
    title = f"{evaluation.get('policy', 'policy')} against pretrained, world {evaluation.get('world', 'unknown')}"
    _print(evaluation.get("objectives") or {}, title, console)


def _print(objectives: Mapping[str, Any], title: str, console: Console | None) -> None:
    from rich.console import Console

    console = console or Console()
    for name, result in objectives.items():
        console.print(_table(result, f"{name}: {title}"))
    if not objectives:
        console.print("No final head-to-head: nothing was compared.")


def _table(result: Mapping[str, Any], title: str) -> Table:
    from rich.table import Table

    unit, speeds = result["unit"], result["speeds"]
    metrics = list(dict.fromkeys(name for speed in speeds.values() for name in speed.get("metrics") or {}))
    table = Table(title=title, title_justify="left", title_style="bold")
    table.add_column("commanded", justify="right")
    for column in ("improvement", "95 % interval", *(wording.label(name).lower() for name in metrics)):
        table.add_column(column, justify="right")
    for column in ("mean speed", "falls", "segments"):
        table.add_column(column, justify="right")
    for key in sorted(speeds, key=float):
        row = speeds[key]
        found = row.get("metrics") or {}
        falls = row.get("falls")
        table.add_row(
            f"{key} m/s",
            wording.quantity(row["improvement"], unit),
            wording.interval(row.get("improvement_ci95"), unit),
            *(wording.metric(name, found.get(name)) for name in metrics),
            f"{wording.number(row.get('mean_speed'))} m/s",
            f"[red]{falls}[/red]" if falls else wording.count(falls),
            wording.count(row.get("segments")),
        )
    return table
