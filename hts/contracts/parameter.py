"""A number of a simulated machine or sensor: its default, and over what it may be drawn for a plausible reality.

A twin's parameter classes and an instrument's settings class are made of these. `hts realities draw` reads what they
say of themselves, so a plugin brings its own parameters by writing its settings this way and registers nothing more.
"""

from __future__ import annotations

from typing import Any

from pydantic import Field


def parameter(
    default: float,
    low: float,
    high: float,
    unit: str,
    source: str,
    meaning: str,
    *,
    drawn: tuple[float, float] | None = None,
    switch: str | None = None,
    fixed: str | None = None,
) -> Any:
    """A pydantic field with meaning, unit, range and source; a value outside the range is refused.

    drawn: over what a reality draws it, if not over the whole range (log-uniform from a factor of ten, else uniform).
    switch: name of a structural switch; the field stays at its default, which means "off", unless a reality has the
    switch, and one coin decides about all fields of that name, wherever they are. fixed: why it is never drawn.
    """
    text = f"{meaning}, {unit}. Range {low:g} to {high:g}. Source: {source}"
    extra: dict[str, Any] = {"unit": unit, "source": source, "range": [low, high]}
    extra |= {"drawn": list(drawn)} if drawn else {}
    extra |= {"switch": switch} if switch else {}
    extra |= {"fixed": fixed} if fixed else {}
    return Field(default, ge=low, le=high, description=text, json_schema_extra=extra)


def parameters(
    default: tuple[float, ...],
    low: float,
    high: float,
    unit: str,
    source: str,
    meaning: str,
    *,
    counts: tuple[int, int],
    drawn: tuple[float, float] | None = None,
    ascending: bool = False,
) -> Any:
    """The same for several values of one kind: between counts[0] and counts[1] of them, ascending if it says so.

    All such fields of one class are drawn with the same number of values.
    """
    text = f"{meaning}, {unit}. Range {low:g} to {high:g}. Source: {source}"
    extra: dict[str, Any] = {"unit": unit, "source": source, "range": [low, high], "counts": list(counts)}
    extra |= {"drawn": list(drawn)} if drawn else {}
    extra |= {"ascending": True} if ascending else {}
    return Field(default, min_length=counts[0], max_length=counts[1], description=text, json_schema_extra=extra)


def structural(switch: str, source: str, meaning: str) -> Any:
    """A field that is False, and True in a reality that has the structural switch."""
    extra: dict[str, Any] = {"unit": "1", "source": source, "switch": switch}
    return Field(False, description=f"{meaning}. Source: {source}", json_schema_extra=extra)
