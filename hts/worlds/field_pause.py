"""Rows of one comparison that were recorded long after each other, in another order or over one another, as the stamps
of their logs tell.

The order A-B-B-A balances what drifts within a visit: charge, heat, the floor. It does not balance what lies between
two visits, or what changed while the robot stood: the pack, a load, a sensor that was set up again. Nor does it balance
anything if a person walked A-A-B-B, and called the logs by their rows. Seconds that are in two logs count twice.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping, Sequence
from datetime import datetime
from itertools import islice, pairwise
from pathlib import Path
from typing import Any

from hts.recordings.mapping import SECONDS
from hts.recordings.reading import DEFAULT_READER, reader_name
from hts.recordings.recording import Recording
from hts.recordings.table import DATES

LONG_SECONDS = 1800.0
"""A runtime asks the same before it walks the rest of a session."""
NOTE = "recorded_apart"
"""Note of the recordings of a comparison of which a row begins so much later, or earlier, than the one before ended."""
ORDER_NOTE = "walked_in_another_order"
OVERLAP_NOTE = "logs_overlap"
"""Notes of those that were walked in another order than planned, and of which one begins before another has ended."""
BEGAN, BOOT = "began_at", "boot"
"""Notes of a runtime: the date at which a row began, and a name for as long as its computer was switched on."""
A_DATE = 1e8
"""s: stamps from here on are dates (1973), by whatever clock; smaller ones may begin anew with each log."""
OVERLAP_SECONDS = 0.5
"""By which logs may overlap: who cuts one long log does it about there."""


def with_pauses(
    recordings: Sequence[Recording], files: Mapping[str, Sequence[Path]], mappings: Sequence[Mapping[str, Any]]
) -> list[Recording]:
    """The recordings, with a NOTE where their session has such a pause, and ORDER_NOTE and OVERLAP_NOTE: they are among
    the doubts that are told.

    files: name of each row -> its log; mappings: by which each was read. A runtime's own clock begins anew whenever its
    computer does, so it notes dates too: they count for rows of two such times. Logs whose clock begins anew with each
    of them say nothing, nor do those of other readers than that of text, or of several files.
    """
    names, found = list(files), list(recordings)
    begins = [_begin(files[name], mapping) for name, mapping in zip(names, mappings, strict=True)]
    cuts = [float((mapping.get("cut") or [0.0])[0]) for mapping in mappings]
    for session in dict.fromkeys(recording.session for recording in found):
        places = [number for number, one in enumerate(found) if one.session == session]
        dates = [_date(found[place], cuts[place]) for place in places]
        one_clock = _one_clock([found[place] for place in places])
        told = [begins[place] for place in places] if one_clock or None in dates else dates
        rows = {
            names[place]: (begin, begin + found[place].seconds)
            for place, begin in zip(places, told, strict=True)
            if begin is not None
        }
        if not rows:
            continue
        said = {NOTE: _pause(rows)}
        if one_clock or min(begin for begin, _ in rows.values()) >= A_DATE:
            said |= {OVERLAP_NOTE: _overlap(rows), ORDER_NOTE: _another_order(rows)}
        notes = {key: f"session {session}: {text}" for key, text in said.items() if text}
        for number, recording in enumerate(found):
            if recording.session == session and notes:
                found[number] = recording.replace(notes={**recording.notes, **notes})
    return found


def _pause(rows: Mapping[str, tuple[float, float]]) -> str:
    """What is said of the first long pause between two rows; "" without one. rows: name -> begin and end, s."""
    for (row, (_, end)), (following, (then, _)) in pairwise(rows.items()):
        if abs(then - end) >= LONG_SECONDS:
            later = f"{_long(then - end)} after row {row} had ended" if then > end else f"before row {row}"
            return (
                f"by its stamps row {following} begins {later}. Rows of a session balance what drifts within one "
                "visit, not what lies between two: if they are of two, walk all of them anew"
            )
    return ""


def _overlap(rows: Mapping[str, tuple[float, float]]) -> str:
    """What is said of a row that begins before another has ended; "" without one."""
    for (row, (_, end)), (following, (then, last)) in pairwise(sorted(rows.items(), key=lambda one: one[1])):
        seconds = min(end, last) - then
        if seconds > OVERLAP_SECONDS:
            return (
                f"by their stamps rows {row} and {following} have {seconds:.1f} s in common, which count twice then. "
                "Cut each log to its own row, or correct the clock"
            )
    return ""


def _another_order(rows: Mapping[str, tuple[float, float]]) -> str:
    """What is said of rows that were not walked one after the other as planned; "" where they were."""
    walked = sorted(rows, key=lambda row: rows[row])
    if walked == list(rows):
        return ""
    return (
        f"by their stamps its rows were walked in the order {', '.join(walked)}, planned was {', '.join(rows)}, which "
        "balances what drifts meanwhile. If logs lie under each other's names, give each its own; else walk all of "
        "them anew in the order of the plan"
    )


def _one_clock(recordings: Sequence[Recording]) -> bool:
    """Whether the stamps of these are of one clock that did not begin anew, as a runtime notes."""
    return len({recording.notes.get(BOOT, "") for recording in recordings}) == 1 and BOOT in recordings[0].notes


def _date(recording: Recording, cut: float) -> float | None:
    """When a row began as a runtime notes it, s since 1970; None where it does not. cut: s that were left out."""
    try:
        return datetime.fromisoformat(recording.notes[BEGAN]).timestamp() + cut
    except (KeyError, ValueError, OverflowError):
        return None


def _begin(files: Sequence[Path], mapping: Mapping[str, Any]) -> float | None:
    """The first stamp that is taken of a log, s; None where it is not told."""
    if len(files) != 1 or reader_name(mapping) != DEFAULT_READER:
        return None
    time = mapping["time"]
    column, unit = time["column"], time["unit"]
    before = int(mapping.get("preamble", 0))
    header = mapping.get("header", True)
    with files[0].open(encoding="utf-8-sig", errors="replace", newline="") as text:
        lines = csv.reader(islice(text, before, None), delimiter=mapping.get("delimiter", ","))
        named = next(lines, []) if header else []
        first = next(islice(lines, int(bool(mapping.get("units_row", False))), None), [])
    try:
        cell = first[named.index(column) if header else int(column)].strip()
        if unit == DATES:
            stamp = datetime.fromisoformat(cell).timestamp()
        else:
            stamp = float(cell.replace(mapping.get("decimal", "."), ".")) * SECONDS[unit]
    except (ValueError, IndexError):
        return None
    return stamp + float((mapping.get("cut") or [0.0])[0]) if math.isfinite(stamp) else None


def _long(seconds: float) -> str:
    return f"{seconds / 3600:.1f} h" if seconds >= 7200 else f"{seconds / 60:.0f} min"
