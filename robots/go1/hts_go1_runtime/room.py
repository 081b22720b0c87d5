"""Whether a visit's rows can be walked to and fro on a straight, what that costs, and the room that it takes."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

from hts_go1_runtime.bundle import Bundle
from hts_go1_runtime.errors import RuntimeFault
from hts_go1_runtime.first_run import FirstRun
from hts_go1_runtime.lane import LEAST_SECONDS, Lane, turn_of
from hts_go1_runtime.options import Options
from hts_go1_runtime.rows import Row
from hts_go1_runtime.trained import ranges_of

SHORTEST, LONGEST = 1.0, 200.0  # m
END, SIDE = 1.0, 1.0  # m that have to be free beyond both ends of the straight, and beside the ways out and back
SLOWER = 1.3  # times as long as at the commanded rate a turn takes (a stand-in, see docs/deployment.md)

Walk = tuple[float, float, float, float]
"""Seconds, vx m/s, vy m/s, yaw rate rad/s."""


def walks_of(bundle: Bundle, rows: Sequence[Row], first_run: bool, warmup: float) -> tuple[list[Walk], list[Walk]]:
    """What a visit walks: where all of the time is what is asked for (warming up, first runs), and where only straight
    walking counts (trimming, rows). warmup: s of walking before the first row."""
    if first_run:
        first = FirstRun.of(bundle.manifest)
        return [one for file in dict.fromkeys(row.policy for row in rows) for one in first.commands(rows, file)], []
    held = 0.0 if bundle.hold is None else bundle.hold.seconds
    trims = [(held, *row.commands[0][1:]) for row in rows if row.trim]
    return [(warmup, *rows[0].commands[0][1:])], [*trims, *(one for row in rows for one in row.commands)]


def lane_for(
    bundle: Bundle,
    rows: Sequence[Row],
    options: Options,
    period: float,
    channels: Sequence[str],
    say: Callable[..., None],
) -> Lane:
    """The lane of a visit with `options.straight`. period: of a step, s; channels: what the link measures; say: an
    event. Raises RuntimeFault for rows that cannot be walked so."""
    assert options.straight is not None
    straight, first_run = options.straight, options.first_run
    settle = float(bundle.manifest["control"]["unsteady_seconds"])
    for row in rows:
        for _, vx, vy, turn in row.commands:
            if vx <= 0 or vy != 0 or turn != 0:
                raise RuntimeFault(
                    f"Row {row.log} commands {vx:g} m/s forward, {vy:g} to the left, {turn:g} rad/s, and --straight is "
                    "for walking straight ahead. Record it without, and the others with --rows."
                )
            speed = vx * FirstRun.of(bundle.manifest).speed_scale if first_run else vx
            least = speed * (settle + LEAST_SECONDS)
            if straight < least:
                raise RuntimeFault(
                    f"--straight {straight:g}: at {speed:g} m/s (row {row.log}) the robot settles for {settle:g} s "
                    f"after each turn, {speed * settle:.1f} m that do not count; expected {least:.1f} m or more. "
                    "Record such rows where there is room, and the others with --rows."
                )
    return Lane(straight, period, settle, _turn(bundle, first_run), "base_velocity" in channels, say)


def room_in_words(bundle: Bundle, rows: Sequence[Row], straight: float, first_run: bool, warmup: float) -> str:
    """What a person has to know of it before the robot stands."""
    forward, rate = _turn(bundle, first_run)
    count, seconds = _turns(bundle, rows, straight, first_run, warmup)
    radius = forward / rate
    unknown = sorted({row.policy for row in rows if "yaw_rate" not in ranges_of(bundle.policies[row.policy])})
    how = "on the spot" if forward == 0 else f"in arcs {2 * radius:.1f} m wide"
    return (
        f"It walks to and fro on {straight:g} m and turns round to the left at both ends, {how}, about {count:.0f} "
        f"times; {seconds / 60:.0f} min in all. It has to stand at one end, facing along the straight, with "
        f"{END + radius:.1f} m free beyond both ends, {SIDE + 2 * radius:.1f} m to its left and {SIDE:.1f} m to its "
        "right. " + (f"Not known whether trained to turn: {', '.join(unknown)}. " if unknown else "")
    )


def _turn(bundle: Bundle, first_run: bool) -> tuple[float, float]:
    """One for all policies of the bundle that are compared, whichever of them walk today."""
    first = FirstRun.of(bundle.manifest)
    return turn_of(bundle.policies.values(), first.speed_scale if first_run else 1.0)


def _turns(bundle: Bundle, rows: Sequence[Row], straight: float, first_run: bool, warmup: float) -> tuple[float, float]:
    """How often it turns, and how long it walks in all, s."""
    settle = float(bundle.manifest["control"]["unsteady_seconds"])
    once = SLOWER * math.pi / _turn(bundle, first_run)[1]
    whole, counted = walks_of(bundle, rows, first_run, warmup)
    turns, seconds = 0.0, 0.0
    for walks, per_turn in ((whole, 0.0), (counted, once + settle)):
        for time, vx, *_ in walks:
            leg = straight / vx + once if not per_turn else (straight - settle * vx) / vx
            turns += time / leg
            seconds += time + time / leg * per_turn
    return turns, seconds
