"""How numbers and names are written, the same in tables, figures and the terminal."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

PERCENT = "1"  # the unit of a fraction; written as per cent
FRACTION_ENDINGS = ("_reduction", "_share", "_fraction")
"""A metric whose name ends so is a fraction and is written as per cent; any other is a plain number."""

Number = float | int | None


def quantity(value: Number, unit: str) -> str:
    """18.2 % for 0.182 of unit "1"; 3.21 dB for 3.21 of "dB"; a dash for nothing."""
    if value is None:
        return "–"
    text = f"{100 * value:z.1f} %" if unit == PERCENT else f"{value:z.2f} {unit}"
    return text.replace("-", "−")


def interval(bounds: Any, unit: str) -> str:
    """15.1 to 21.3 %; a dash for nothing."""
    if not bounds or bounds[0] is None or bounds[1] is None:
        return "–"
    low, high = (quantity(bound, unit) for bound in bounds)
    return f"{low.rsplit(' ', 1)[0]} to {high}"


def number(value: Number, digits: int = 2) -> str:
    return "–" if value is None else f"{value:z.{digits}f}".replace("-", "−")


def metric(name: str, value: Number) -> str:
    """A metric of an objective, written by the ending of its name."""
    return quantity(value, PERCENT) if name.endswith(FRACTION_ENDINGS) else number(value)


def heading(name: str, units: Mapping[str, str]) -> str:
    """Of a column of a metric: its name, and its unit where the objective says one."""
    unit = units.get(name, PERCENT)
    return label(name) + (f", {unit}" if unit != PERCENT else "")


def label(name: str) -> str:
    """cost_of_transport_reduction -> Cost of transport reduction."""
    text = name.replace("_", " ")
    return text[:1].upper() + text[1:]


def metric_names(speeds: Mapping[str, Mapping[str, Any]]) -> tuple[list[str], list[str]]:
    """Names of the metrics of an objective's result by speed: those that say more than the improvement, and those that
    are the improvement itself, which would only be shown twice."""
    rows = [(row["improvement"], row.get("metrics") or {}) for row in speeds.values()]
    names = dict.fromkeys(name for _, metrics in rows for name in metrics)
    same = [name for name in names if all(metrics.get(name) == improvement for improvement, metrics in rows)]
    return [name for name in names if name not in same], same


def scale(unit: str) -> tuple[float, str]:
    """(factor, axis unit) for plotting values of this unit."""
    return (100.0, "%") if unit == PERCENT else (1.0, unit)


def bound(value: Number) -> str:
    """A KL bound c: 0.5, or ∞ where there is none."""
    return "∞" if value is None else f"{value:g}"


def weights(values: Mapping[str, float]) -> str:
    """λ of a candidate: 0.5, or one per objective that has any."""
    if len(values) == 1:
        return f"{next(iter(values.values())):g}"
    return " + ".join(f"{value:g} {name}" for name, value in values.items() if value) or "0"


def duration(seconds: Number) -> str:
    """9 min 14 s."""
    if seconds is None:
        return "–"
    whole = round(seconds)
    hours, minutes, rest = whole // 3600, whole // 60 % 60, whole % 60
    if hours:
        return f"{hours} h {minutes} min"
    return f"{minutes} min {rest} s" if minutes else f"{rest} s"


def count(value: Number) -> str:
    """1 234 567, with thin spaces."""
    return "–" if value is None else f"{value:,}".replace(",", "\u2009")


HELD, OPEN_LOOP = ", at held speed", ", at equal commands (open loop)"


def ways(result: Mapping[str, Any]) -> list[tuple[Mapping[str, Any], str]]:
    """The parts of an objective's final result and the words for each: at held speed, and at equal commands beside it;
    of a run that held no speed the only one, without a word."""
    beside = result.get("open_loop")
    return [(result, "")] if beside is None else [(result, HELD), (beside, OPEN_LOOP)]
