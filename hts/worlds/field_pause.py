"""Rows of one comparison that were recorded long after each other, as the stamps of their logs tell.

The order A-B-B-A balances what drifts within a visit: charge, heat, the floor. It does not balance what lies between
two visits, or what changed while the robot stood: the pack, a load, a sensor that was set up again.
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


def with_pauses(
    recordings: Sequence[Recording], files: Mapping[str, Sequence[Path]], mappings: Sequence[Mapping[str, Any]]
) -> list[Recording]:
    """The recordings, with a NOTE where their session has such a pause: it is among the doubts that are told.

    files: name of each row -> its log; mappings: by which each was read. Logs whose clock begins anew with each of them
    say nothing, nor do those of other readers than that of text, or of several files.
    """
    names, found = list(files), list(recordings)
    begins = [_begin(files[name], mapping) for name, mapping in zip(names, mappings, strict=True)]
    for row, following in pairwise(range(len(names))):
        first, then = begins[row], begins[following]
        one, other = recordings[row], recordings[following]
        if first is None or then is None or one.session != other.session:
            continue
        pause = then - first - one.seconds
        if abs(pause) < LONG_SECONDS:
            continue
        later = f"{_long(pause)} after row {names[row]} had ended" if pause > 0 else f"before row {names[row]}"
        text = (
            f"session {one.session}: by its stamps row {names[following]} begins {later}. Rows of a session balance "
            "what drifts within one visit, not what lies between two: if they are of two, walk all of them anew"
        )
        for number, recording in enumerate(found):
            if recording.session == one.session and NOTE not in recording.notes:
                found[number] = recording.replace(notes={**recording.notes, NOTE: text})
    return found


def _begin(files: Sequence[Path], mapping: Mapping[str, Any]) -> float | None:
    """The first stamp of a log, s; None where it is not told."""
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
            return datetime.fromisoformat(cell).timestamp()
        stamp = float(cell.replace(mapping.get("decimal", "."), ".")) * SECONDS[unit]
    except (ValueError, IndexError):
        return None
    return stamp if math.isfinite(stamp) else None


def _long(seconds: float) -> str:
    return f"{seconds / 3600:.1f} h" if seconds >= 7200 else f"{seconds / 60:.0f} min"
