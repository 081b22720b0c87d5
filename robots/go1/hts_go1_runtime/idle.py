"""Idle levels: what the battery monitor shows with electronics on and motors idle, before a visit and after it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from hts_go1_runtime.errors import RuntimeFault
from hts_go1_runtime.link import NOTHING
from hts_go1_runtime.log import REAL
from hts_go1_runtime.loop import Loop

AGREES = 0.03  # of the level: a larger difference before and after a visit is something else that draws
LEAST_SHARE = 0.5  # of the readings must be numbers: a monitor that gives fewer is not read steadily

Readings = Mapping[str, np.ndarray]


def readings(loop: Loop, channels: Sequence[str], seconds: float) -> Readings:
    """What the battery monitor shows for so long, each of the channels that need an idle level, motors idle."""
    seen: dict[str, list[float]] = {name: [] for name in REAL if name in channels}
    for _ in range(round(seconds / loop.period)):
        state = loop.tick(lambda _: NOTHING)
        for name, value in (("battery_current", state.current), ("battery_voltage", state.voltage)):
            if name in seen:
                seen[name].append(value)
    return {name: np.array(values, float) for name, values in seen.items()}


def levels(seen: Readings) -> dict[str, float]:
    """The mean of each channel over its readings that are numbers; channels that have none are left out."""
    finite = {name: values[np.isfinite(values)] for name, values in seen.items()}
    return {name: float(values.mean()) for name, values in finite.items() if values.size}


def check_read(seen: Readings) -> None:
    """Raise RuntimeFault where too few readings are numbers: the mean of a few would be no level, and the rows would
    lack as many samples."""
    for name, values in seen.items():
        count = int(np.isfinite(values).sum())
        if count < LEAST_SHARE * values.size:
            raise RuntimeFault(
                f"{name}: {count} of {values.size} readings while idle are numbers, expected half of them at least: "
                "the battery monitor is not read steadily. Start the robot's own process that reads it again."
            )


def changed(before: Mapping[str, float], after: Mapping[str, float]) -> bool:
    """Whether something else draws after a visit than before.

    The voltage sinks as the pack is used, and electronics behind a converter then draw more current for the same power,
    others less: so neither current nor power alone tells, but both together.
    """

    def differs(*names: str) -> bool:
        first, last = (math.prod(levels[name] for name in names) for levels in (before, after))
        return abs(last - first) > AGREES * abs(first)

    current, voltage = "battery_current", "battery_voltage"
    if not (current in before and current in after) or not differs(current):
        return False
    return not (voltage in before and voltage in after) or differs(current, voltage)
