"""Rows that ask a policy for more than it was trained for: a person is told before the robot moves."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence

from hts_go1_runtime.errors import RuntimeFault
from hts_go1_runtime.policy import Policy
from hts_go1_runtime.rows import Row

AXES = {"vx": (1, "m/s forward"), "vy": (2, "m/s sideways"), "yaw_rate": (3, "rad/s turning")}
"""Key in the manifest's `trained.commands` -> where it stands in a row's command, and in words."""
SLACK = 1e-6  # float32 on its way through a card


def check_trained(trained: object, where: str) -> None:
    """Raise RuntimeFault for what says neither null (nobody knows) nor ranges of commands."""
    if trained is None:
        return
    commands = trained.get("commands") if isinstance(trained, Mapping) else None
    ranges = {key: commands[key] for key in AXES if key in commands} if isinstance(commands, Mapping) else None
    if ranges is None or not all(_is_range(one) for one in ranges.values()):
        raise RuntimeFault(
            f"{where}: trained {str(trained)[:60]}, expected null, or `commands` with a smallest and a largest each."
        )


def beyond(rows: Sequence[Row], policies: Mapping[str, Policy]) -> list[str]:
    """What rows ask for beyond what their policy was trained for, each thing once, in words. Slower than trained is
    not told: a robot that is told to walk slowly may shuffle, one that is told to hurry falls."""
    found: dict[str, list[str]] = {}
    for row in rows:
        for what in dict.fromkeys(_beyond(row, policies[row.policy].entry.get("trained"))):
            found.setdefault(what, []).append(row.log)
    return [f"{what} (rows {', '.join(logs)})" for what, logs in found.items()]


def _beyond(row: Row, trained: Mapping[str, Mapping[str, Sequence[float]]] | None) -> Iterator[str]:
    ranges = trained["commands"] if trained else {}
    for key, (place, unit) in AXES.items():
        if key in ranges:
            low, high = min(0.0, ranges[key][0]), max(0.0, ranges[key][1])
            for command in row.commands:
                if not low - SLACK <= command[place] <= high + SLACK:
                    end = high if command[place] > 0 else low
                    yield f"{command[place]:g} {unit}, trained to {end:g}"


def _is_range(values: object) -> bool:
    if not isinstance(values, list | tuple) or len(values) != 2:
        return False
    return all(type(one) in (int, float) and math.isfinite(one) for one in values) and values[0] <= values[1]
