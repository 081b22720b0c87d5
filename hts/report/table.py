"""The table at the end of `hts run` and `hts evaluate`."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.measure import Measurement
from rich.table import Table

from hts.policy_ids import PRETRAINED
from hts.report import wording
from hts.report.outcome import closing
from hts.report.task_words import VELOCITY, TaskWords


def print_table(summary: Mapping[str, Any], console: Console) -> None:
    """Print the final head-to-head of a summary.json, one table per objective."""
    final = summary.get("final") or {}
    for line in (*([summary["note"]] if summary.get("note") else ()), *closing(summary)):
        console.print(line, soft_wrap=True, markup=False, highlight=False)
    if final.get("policy") == PRETRAINED:
        return
    title = f"{final.get('policy') or 'final'} policy against pretrained"
    _print(final.get("objectives") or {}, title, console, TaskWords.of(summary))
    if len(summary.get("objectives") or ()) > 1 and (summary.get("front") or {}).get("real"):
        console.print(_front_table(summary))


def print_evaluation(evaluation: Mapping[str, Any], console: Console | None = None) -> None:
    """Print an evaluation.json, one table per objective."""
    title = f"{evaluation.get('policy', 'policy')} against pretrained, world {evaluation.get('world', 'unknown')}"
    _print(evaluation.get("objectives") or {}, title, console or Console(), TaskWords.of(evaluation))


def _print(objectives: Mapping[str, Any], title: str, console: Console, task: TaskWords) -> None:
    for name, result in objectives.items():
        for part, words in wording.ways(result):
            about = {key: result[key] for key in ("unit", "metric_units") if key in result}
            for table in fitting({**about, **part}, f"{name}: {title}{words}", console, task):
                console.print(table)
            for line in (part.get("refused") or {}).values():
                console.print(f"{name}{words}: {line}", style="red", markup=False)
    if not objectives:
        console.print("No final head-to-head: nothing was compared.")


def _front_table(summary: Mapping[str, Any]) -> Table:
    """The policies that no other beats in all objectives, best first in the first one."""
    objectives, front = list(summary["objectives"]), summary["front"]
    title = "front: beaten by no other policy tried, during the iterations"
    table = Table(title=title, title_justify="left", title_style="bold", box=SIMPLE_HEAD, padding=0)
    table.add_column("policy", no_wrap=True)
    for name in objectives:
        table.add_column(name, justify="right", no_wrap=True)
        table.add_column("counts as", justify="right", no_wrap=True)
    for entry in sorted(front["real"], key=lambda one: -one["improvements"][objectives[0]]["selection_score"]):
        cells = []
        for name in objectives:
            gain, unit = entry["improvements"][name], front["units"][name]
            cells += [wording.quantity(gain["improvement"], unit), wording.quantity(gain["selection_score"], unit)]
        table.add_row(entry["id"], *cells)
    return table


def fitting(result: Mapping[str, Any], title: str, console: Console, task: TaskWords = VELOCITY) -> list[Table]:
    """One table if the console is wide enough for all of it, else the metrics in tables of their own below.

    A heading may break between words, never inside one. One metric a table is as narrow as it gets.
    """

    def made(title: str, metrics: Sequence[str], numbers: bool = False) -> Table:
        """With headings in one line where there is room for that."""
        table = _table(result, title, metrics, task, numbers)
        return table if _fits(table, console) else _table(result, title, metrics, task, numbers, broken=True)

    metrics, _ = wording.metric_names(result["speeds"])
    whole = made(title, metrics, numbers=True)
    if not metrics or _fits(whole, console):
        return [whole]
    tables, waiting = [made(title, [], numbers=True)], metrics
    while waiting:
        count = next((n for n in range(len(waiting), 1, -1) if _fits(made("", waiting[:n]), console)), 1)
        tables.append(made("", waiting[:count]))
        waiting = waiting[count:]
    return tables


def _fits(table: Table, console: Console) -> bool:
    """Whether every line of the table has its place: rich would cut off what it makes narrower."""
    wide = console.options.update(width=10_000)  # what it needs, not what there is
    return Measurement.get(console, wide, table).maximum <= console.width


def _table(
    result: Mapping[str, Any],
    title: str,
    metrics: Sequence[str],
    task: TaskWords,
    numbers: bool = False,
    broken: bool = False,
) -> Table:
    """One row a speed, or set-point. numbers: improvement, speed, falls and segments too; broken: headings of several
    words are as narrow as their longest one."""
    unit, speeds = result["unit"], result["speeds"]
    table = Table(title=title or None, title_justify="left", title_style="bold", box=SIMPLE_HEAD, padding=0)
    table.add_column(task.column, justify="right", no_wrap=True)
    for column in ("improvement", "95 % interval") if numbers else ():
        table.add_column(column, justify="right", no_wrap=True)
    for column in (
        *(_lower(wording.heading(name, result.get("metric_units") or {})) for name in metrics),
        *((task.achieved_column, "falls", "segments") if numbers else ()),
    ):
        longest = max(map(len, column.split()), default=1)
        table.add_column(textwrap.fill(column, longest) if broken else column, justify="right")
    for key in sorted(speeds, key=float):
        row = speeds[key]
        falls, found = row.get("falls"), row.get("metrics") or {}
        first = [wording.quantity(row["improvement"], unit), wording.interval(row.get("improvement_ci95"), unit)]
        last = [
            wording.number(row.get("mean_speed")),
            f"[red]{falls}[/red]" if falls else wording.count(falls),
            wording.count(row.get("segments")),
        ]
        shown = [wording.metric(name, found.get(name)) for name in metrics]
        table.add_row(task.point(key), *(first if numbers else ()), *shown, *(last if numbers else ()))
    return table


def _lower(heading: str) -> str:
    """With a small first letter; a unit stays as it is."""
    return heading[:1].lower() + heading[1:]
