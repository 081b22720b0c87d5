"""A number of a simulated machine or sensor: its default, and over what it may be drawn for a plausible reality.

A twin's parameter classes and an instrument's settings class are made of these. `hts realities draw` reads what they
say of themselves, so a plugin brings its own parameters by writing its settings this way and registers nothing more.
"""

from __future__ import annotations

from typing import Any

from pydantic import Field

from hts.errors import PluginError


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
    Raises PluginError for a default or a `drawn` outside the range, which pydantic does not look at.

    switch: name of a structural switch; the field stays at its default, which means "off", unless a reality has the
    switch, and one coin decides about all fields of that name, wherever they are. fixed: why it is never drawn.
    """
    _check(meaning, (default,), low, high, drawn)
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
    _check(meaning, default, low, high, drawn)
    text = f"{meaning}, {unit}. Range {low:g} to {high:g}. Source: {source}"
    extra: dict[str, Any] = {"unit": unit, "source": source, "range": [low, high], "counts": list(counts)}
    extra |= {"drawn": list(drawn)} if drawn else {}
    extra |= {"ascending": True} if ascending else {}
    return Field(default, min_length=counts[0], max_length=counts[1], description=text, json_schema_extra=extra)


def _check(
    meaning: str, defaults: tuple[float, ...], low: float, high: float, drawn: tuple[float, float] | None
) -> None:
    """Raise PluginError for ranges whose ends are the wrong way round, or that do not hold what they should."""
    if not low <= high:
        raise PluginError(f"parameter '{meaning}': its range is {low:g} to {high:g}, expected the lower end first")
    for what, values in (("its default", defaults), ("drawn", drawn or ())):
        for value in values:
            if not low <= value <= high:
                raise PluginError(f"parameter '{meaning}': {what} is {value:g}, outside its range {low:g} to {high:g}")
    if drawn and not drawn[0] <= drawn[1]:
        raise PluginError(f"parameter '{meaning}': drawn is {drawn[0]:g} to {drawn[1]:g}, expected the lower end first")


def structural(switch: str, source: str, meaning: str) -> Any:
    """A field that is False, and True in a reality that has the structural switch."""
    extra: dict[str, Any] = {"unit": "1", "source": source, "switch": switch}
    return Field(False, description=f"{meaning}. Source: {source}", json_schema_extra=extra)
