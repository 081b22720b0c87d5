"""Rows of a log that are no part of its run, such as turns at a wall between two walks: left out by a column that says
what was commanded in each row, and the clock closed up over them.

    only: {column: phase, number: 0}

What is left is the run as its schedule has it: the seconds before and after a turn follow each other by one sample
period. Nothing that was measured decides here.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hts.errors import RecordingError
from hts.recordings.mapping import LogMapping
from hts.recordings.repeated import runs_of
from hts.recordings.sources import Source
from hts.recordings.stretches import Stretch

NOTE, CLOSED = "rows_left_out", "closed_up_at"
"""Notes of a recording of which rows were left out: how many, and where, s after its first sample."""


def closed_up(part: Stretch, log: LogMapping) -> Stretch:
    """The stretch without the rows that `only` leaves out; it has `times`. Tables of other sources lose the same spans.

    A log that ends in a fall and has no two rows that count, since the robot fell while it turned, is kept as it is.
    Raises RecordingError where nothing, or no such number, is left.
    """
    only, times = log.only, part.times
    if only is None or times is None:
        return part
    own = Source(only.file, only.topic)
    table, clock = part.tables[own], times[own]
    counts = _filled(table.columns[only.column]) == only.number
    if counts.sum() < 2:
        if log.recording.fell:
            return part
        found = ", ".join(f"{one:g}" for one in np.unique(table.columns[only.column])[:8])
        raise RecordingError(
            f"{table.path}: in {int(counts.sum())} rows '{only.column}' is {only.number:g}, those that count (only); "
            f"it holds {found}. Correct `only` in the mapping, or record it again."
        )
    spans = [(_after(clock, first, log.rate_hz), _before(clock, end, log.rate_hz)) for first, end in runs_of(~counts)]
    tables, moved = {}, {}
    for source, one in part.tables.items():
        when = times[source]
        kept = counts if source == own else ~_inside(when, spans)
        if kept.sum() < 2:
            raise RecordingError(f"{one.path}: nothing of it is in the rows that count (only). Correct the mapping.")
        tables[source], moved[source] = one.rows(kept), when[kept] - _gone(when[kept], spans)
    if not spans:
        return part
    between = [(begin, end) for begin, end in spans if np.isfinite([begin, end]).all()]
    first = moved[own][0]
    at = ", ".join(f"{begin - _gone(np.array([begin]), spans)[0] - first:.2f}" for begin, _ in between)
    notes = {**part.notes, NOTE: f"{int((~counts).sum())} of {len(counts)} ('{only.column}' is not {only.number:g})"}
    return Stretch(tables, {**notes, CLOSED: at} if at else notes, moved)


def _filled(values: np.ndarray) -> np.ndarray:
    """Each row's number (rows,), or that of the row before it where it has none."""
    there = np.maximum.accumulate(np.where(np.isfinite(values), np.arange(len(values)), -1))
    return np.where(there < 0, np.nan, values[there])


def _after(clock: np.ndarray, first: int, rate_hz: float) -> float:
    """Where a span begins that has been left out: half a sample after the row before it."""
    return -np.inf if first == 0 else float(clock[first - 1]) + 0.5 / rate_hz


def _before(clock: np.ndarray, end: int, rate_hz: float) -> float:
    """Where it ends: half a sample before the row after it."""
    return np.inf if end == len(clock) else float(clock[end]) - 0.5 / rate_hz


def _inside(times: np.ndarray, spans: Sequence[tuple[float, float]]) -> np.ndarray:
    return np.logical_or.reduce(
        [(times > begin) & (times < end) for begin, end in spans] or [np.zeros(len(times), bool)]
    )


def _gone(times: np.ndarray, spans: Sequence[tuple[float, float]]) -> np.ndarray:
    """How much was left out before each time (rows,), s; what comes before the first row that counts is dropped."""
    gone = np.zeros(len(times))
    for begin, end in spans:
        if np.isfinite([begin, end]).all():
            gone += np.where(times >= end, end - begin, 0.0)
    return gone
