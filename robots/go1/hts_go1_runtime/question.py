"""What is asked before a robot moves, with all that a person should know by then."""

from __future__ import annotations

import math
import time
from collections.abc import Iterable, Sequence
from dataclasses import replace

from hts_go1_runtime.bundle import Bundle
from hts_go1_runtime.events import Events
from hts_go1_runtime.first_run import FirstRun, never_walked
from hts_go1_runtime.meeting import unguarded
from hts_go1_runtime.room import room_in_words, walks_of
from hts_go1_runtime.rows import Row
from hts_go1_runtime.trained import beyond
from hts_go1_runtime.when import began

LONG = 1800.0
"""Seconds since the last log of a session after which its other blocks are not walked beside it any more: charge, heat
and floor are others. A swap of the battery in the midst of a visit takes less."""
AHEAD = 600.0  # s: a file's time may be its last line's, and a row's length is added to it


def question(
    bundle: Bundle,
    rows: Sequence[Row],
    events: Events,
    *,
    volts: float,
    first_run: bool,
    vouched: Iterable[str],
    channels: Sequence[str],
    warmup: float,
    straight: float | None = None,
) -> str:
    """The question; what needs a look is said to `events` too. vouched: files of policies that failed the gate;
    channels: what the link measures; first_run: each policy walks slowly and weakly, and nothing is recorded; warmup: s
    of walking before the first row; straight: m, on which it walks to and fro, None: straight on."""
    other = [bundle.other_robot] if bundle.other_robot else []
    if other:
        events.say("made for another robot", robot=bundle.other_robot)
    new = [] if first_run else never_walked(bundle, rows)
    if new:
        events.say("no first run", policies=new)
    # A first run trims nothing, so no end of trimming keeps its commands down.
    more = beyond(slowly(bundle, rows) if first_run else rows, bundle.policies, None if first_run else bundle.fastest)
    if more:
        events.say("more than trained for", rows=more)
    old = [] if first_run else begun_long_ago(bundle, rows, time.time())
    if old:
        events.say("sessions go on that were begun long ago", sessions=old)
    untried = [file for file, policy in bundle.policies.items() if policy.entry["gate"] is None]
    return (
        f"{len(rows)} rows, {sum(row.seconds for row in rows):.0f} s; the pack has {volts:.1f} V. "
        + _said("Made for another robot, so go on only if this is one", other)
        + _said("Not tried over simulated machines", untried)
        + _said("Failed the gate, vouched for", vouched)
        + _said("Never walked from this bundle, nor slowly first (--first-run)", new)
        + _said("More than trained for", more, "; ")
        + _said(
            "Begun long ago, so that blocks far apart would be compared (move its logs away to walk all)", old, "; "
        )
        + unguarded(channels)
        + (_no_speed(channels) + room_in_words(bundle, rows, straight, first_run, warmup) if straight else "")
        + f"It walks about {metres(bundle, rows, first_run, warmup):.0f} m {'besides turning, ' if straight else ''}"
        + "without a pause, keeps its heading and sees nothing that is in its way. "
        + "The robot will stand up and walk. Is everybody clear?"
    )


def metres(bundle: Bundle, rows: Sequence[Row], first_run: bool, warmup: float) -> float:
    """How far a visit walks from standing up to sitting down, m, at the speeds that are asked for."""
    whole, counted = walks_of(bundle, rows, first_run, warmup)
    return sum(seconds * math.hypot(vx, vy) for seconds, vx, vy, _ in (*whole, *counted))


def _no_speed(channels: Sequence[str]) -> str:
    if "base_velocity" in channels:
        return ""
    return (
        "The link gives no speed of the trunk: where the straight ends is told from the commanded speed, and a policy "
        "may walk half as fast again (t, then Enter, turns it round). "
    )


def slowly(bundle: Bundle, rows: Sequence[Row]) -> list[Row]:
    """Rows as a first run walks them."""
    scale = FirstRun.of(bundle.manifest).speed_scale
    return [
        replace(row, commands=tuple((s, scale * vx, scale * vy, scale * turn) for s, vx, vy, turn in row.commands))
        for row in rows
    ]


def begun_long_ago(bundle: Bundle, rows: Sequence[Row], now: float) -> list[str]:
    """Sessions of some rows that compare policies and of which other rows have logs, the last of them `LONG` ago: its
    name, hours and logs. A log of a time that is still to come was recorded before this computer's clock was set back,
    nobody knows how long ago. now: s, as files' times are told."""
    asked = {row.log for row in rows}
    found = []
    for session in dict.fromkeys(row.session for row in rows if row.role != "collection"):
        others = [row for row in bundle.rows if row.session == session and row.log not in asked]
        ends = {row.log: at + row.seconds for row in others if (at := began(bundle.logs, row.log)) is not None}
        ago = now - max(ends.values(), default=now)
        if ago < -AHEAD:
            found.append(f"{session} (by a clock that was set back since, logs {', '.join(ends)})")
        elif ago > LONG:
            found.append(f"{session} ({ago / 3600:.1f} h, logs {', '.join(ends)})")
    return found


def _said(what: str, found: Iterable[str], between: str = ", ") -> str:
    listed = between.join(found)
    return f"{what}: {listed}. " if listed else ""
