"""Several runs in one log: told apart by a column, by gaps, or by a file of labels."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from hts.errors import RecordingError
from hts.recordings.labels import Label, read_labels
from hts.recordings.mapping import SECONDS, LogMapping
from hts.recordings.sources import Source, Tables

MOST_RUNS = 10_000


class Stretch(NamedTuple):
    """Part of a log that becomes a recording, and what to note of it.

    times: of each table's rows on one clock, s after the first of them, where that clock is of more than this part;
    None: the part's own stamps tell.
    """

    tables: Tables
    notes: Mapping[str, str]
    times: Mapping[Source, np.ndarray] | None = None


def stretches(
    tables: Tables, times: Mapping[Source, np.ndarray], log: LogMapping, assigned: Mapping[str | None, Path]
) -> list[Stretch]:
    """The parts that the mapping asks for, in order of time; the whole log where it asks for none.

    times: of each table's rows, on one clock, s. Raises RecordingError where there is nothing to take, or a file of
    labels cannot be read.
    """
    if log.runs is not None:
        parts = _runs(tables, log)
    elif log.labels is not None:
        parts = _labelled(tables, times, log, read_labels(assigned[log.labels.file], log.labels))
    else:
        parts = [Stretch(tables, {}, times)]
    return parts


def _runs(tables: Tables, log: LogMapping) -> list[Stretch]:
    assert log.runs is not None
    (source, table), *others = tables.items()
    where, runs = table.path, log.runs
    if others:
        raise RecordingError(f"{where}: `runs` are told apart by rows, but its channels are of several topics.")
    if runs.column is not None:
        number = table.columns[runs.column]
        begins = np.flatnonzero(number[1:] != number[:-1]) + 1
        values = number[[0, *begins]].tolist()
        names = [str(int(value)) if value.is_integer() else repr(value) for value in values]
        key = f"run_{runs.column}" if str(runs.column).isidentifier() else "run"
    else:
        steps = np.diff((table.stamps - table.stamps[0]) * SECONDS[log.time.unit])
        begins = np.flatnonzero(steps > (runs.gap_seconds or 0)) + 1
        values = [float(count + 1) for count in range(len(begins) + 1)]
        names, key = [str(int(value)) for value in values], "run"
    if len(names) > MOST_RUNS:
        raise RecordingError(
            f"{where}: {len(names)} runs, at most {MOST_RUNS} are read. Is '{runs.column}' their column?"
        )
    edges = [0, *begins.tolist(), len(table.stamps)]
    found = []
    for name, value, first, last in zip(names, values, edges, edges[1:], strict=False):
        if runs.take is not None and value not in runs.take:
            continue
        rows = np.arange(first, last)
        if len(rows) < 2:
            raise RecordingError(
                f"{where}: run {name} ({runs.column or 'by gaps'}) has one row. Leave it out by `take`."
            )
        found.append(Stretch({source: table.rows(rows)}, {key: name}))
    if not found:
        known = ", ".join(list(dict.fromkeys(names))[:20])
        raise RecordingError(f"{where}: none of the runs in '{runs.column}' is asked for. It has {known}.")
    return found


def _labelled(
    tables: Tables, times: Mapping[Source, np.ndarray], log: LogMapping, labels: Sequence[Label]
) -> list[Stretch]:
    assert log.labels is not None
    take = log.labels.take
    if take is None:
        noted = "; ".join(f"{one.start:g} to {one.end:g} s {one.word}" for one in labels)
        return [Stretch(tables, {"labels": noted}, times)]
    found = []
    for one in labels:
        if one.word not in take:
            continue
        part, inside = {}, {}
        for source, table in tables.items():
            kept = (times[source] >= one.start) & (times[source] <= one.end)
            if kept.sum() < 2:
                raise RecordingError(
                    f"{table.path}: nothing is there from {one.start:g} to {one.end:g} s, labelled '{one.word}'; it "
                    f"lasts {times[source][-1]:.4g} s. Correct the labels, or the unit of the stamps."
                )
            part[source], inside[source] = table.rows(kept), times[source][kept]
        earliest = min(one[0] for one in inside.values())
        own = {source: there - earliest for source, there in inside.items()} if log.join is not None else None
        found.append(Stretch(part, {"labels": f"{one.start:g} to {one.end:g} s {one.word}"}, own))
    if not found:
        known = ", ".join(dict.fromkeys(one.word for one in labels))
        raise RecordingError(f"Labels: none of them is {' or '.join(take)}. They are {known}.")
    return found
