"""Rows that ask a policy for more than it was trained for: a person is told before the robot moves."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence

from hts_go1_runtime.errors import RuntimeFault
from hts_go1_runtime.policy import Policy
from hts_go1_runtime.rows import Row

AXES = {
    "vx": (1, "m/s forward", "m/s backwards"),
    "vy": (2, "m/s to the left", "m/s to the right"),
    "yaw_rate": (3, "rad/s to the left", "rad/s to the right"),
}
"""Key in the manifest's `trained.commands` -> where it stands in a row's command, and its directions in words."""
SLACK = 1e-6  # float32 on its way through a card

Ranges = Mapping[str, Sequence[float]]
"""Key of `AXES` -> smallest and largest command that a policy was trained with; what is not known is not in it."""


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


def ranges_of(policy: Policy) -> Ranges:
    """What a policy was trained with, as far as it is known."""
    return (policy.entry.get("trained") or {}).get("commands", {})


def beyond(rows: Iterable[Row], policies: Mapping[str, Policy], fastest: float | None = None) -> list[str]:
    """What rows ask for beyond what their policy was trained for: the most of it, for each policy and direction.

    fastest: m/s, at which trimming ends: a row whose speed is held is sent no more. Slower than trained is not told: a
    robot that is told to walk slowly may shuffle, one that is told to hurry falls.
    """
    most: dict[tuple[str, str, bool], float] = {}
    logs: dict[tuple[str, str, bool], list[str]] = {}
    for row in rows:
        for key, (place, *_) in AXES.items():
            for command in row.commands:
                value = command[place]
                if key == "vx" and fastest is not None and row.role != "collection":
                    value = min(value, fastest)
                if over(ranges_of(policies[row.policy]), key, value):
                    about = (row.policy, key, value > 0)
                    most[about] = max(most.get(about, 0.0), abs(value))
                    logs.setdefault(about, []).append(row.log)
    told = []
    for (file, key, positive), value in most.items():
        low, high = ranges_of(policies[file])[key]
        rows_named = ", ".join(dict.fromkeys(logs[file, key, positive]))
        told.append(
            f"{file}: {value:g} {AXES[key][1 if positive else 2]} (rows {rows_named}), trained for {low:g} to {high:g}"
        )
    return told


def turns(ranges: Ranges, most: float) -> tuple[float, float]:
    """Limits of the yaw rate that keeps a heading, rad/s: those of training, which cut it off there, and `most`."""
    low, high = ranges.get("yaw_rate", (-most, most))
    return max(-most, min(low, 0.0)), min(most, max(high, 0.0))


def over(ranges: Ranges, key: str, value: float) -> bool:
    """Whether a command lies beyond what was trained, in its own direction."""
    if key not in ranges:
        return False
    low, high = min(0.0, ranges[key][0]), max(0.0, ranges[key][1])
    return not low - SLACK <= value <= high + SLACK


def _is_range(values: object) -> bool:
    if not isinstance(values, list | tuple) or len(values) != 2:
        return False
    return all(type(one) in (int, float) and math.isfinite(one) for one in values) and values[0] <= values[1]
