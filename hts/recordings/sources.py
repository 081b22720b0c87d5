"""Which file is which, and the tables of one log: one per file, or per topic of a file of messages."""

from __future__ import annotations

import fnmatch
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from hts.errors import ConfigError, RecordingError
from hts.recordings.mapping import SECONDS, ChannelMapping, LogMapping, Mapped
from hts.recordings.table import ColumnName, Table


class Source(NamedTuple):
    """Where columns share their stamps: a name under `files`, and a topic; None where there is only one."""

    file: str | None
    topic: str | None


Tables = dict[Source, Table]

RECEIVED_APART = 0.1
"""s by which topics may differ in how long after their stamps they are received: what reading and sending takes."""


def source_of(one: ChannelMapping) -> Source:
    """Where a channel's columns are."""
    return Source(one.file, one.topic)


def assign(files: Sequence[Path], log: LogMapping) -> dict[str | None, Path]:
    """Which file is which of the mapping's `files`; {None: the file} where the mapping has none.

    Raises ConfigError where a pattern fits none or several, or a file fits no pattern.
    """
    if log.files is None:
        if len(files) != 1:
            raise ConfigError(
                f"Mapping: {len(files)} files for one recording: {', '.join(str(path) for path in files)}. Take away "
                "those that are no log of it (a copy, a note), name them under `files`, or import one by one."
            )
        return {None: files[0]}
    assigned: dict[str | None, Path] = {}
    for name, pattern in log.files.items():
        matching = [path for path in files if fnmatch.fnmatch(path.name, pattern)]
        if len(matching) != 1:
            given = ", ".join(path.name for path in files)
            raise ConfigError(
                f"Mapping: files.{name}: pattern '{pattern}' fits {len(matching)} of the files ({given}), not one."
            )
        assigned[name] = matching[0]
    unused = [str(path) for path in files if path not in assigned.values()]
    if unused:
        raise ConfigError(f"Mapping: no pattern under `files` fits {', '.join(unused)}. Add one or leave the file out.")
    return assigned


def read_tables(
    assigned: Mapping[str | None, Path],
    log: Mapped,
    columns: Mapping[str, tuple[ColumnName, ...]],
    read: Callable[[Path, Sequence[ColumnName], Mapped], Table],
) -> Tables:
    """Every table that a channel needs; a reader of messages finds the topic in `mapping.topic`."""
    tables: Tables = {}
    sources = [source_of(one) for one in log.channels.values()]
    phases = None if log.only is None else Source(log.only.file, log.only.topic)
    for source in dict.fromkeys(sources if phases is None else [*sources, phases]):
        wanted = [column for name, one in log.channels.items() if source_of(one) == source for column in columns[name]]
        if log.runs is not None and log.runs.column is not None:
            wanted.append(log.runs.column)
        if log.only is not None and source == phases:
            wanted.append(log.only.column)
        told = log if source.topic is None else log.model_copy(update={"topic": source.topic})
        tables[source] = read(assigned[source.file], tuple(dict.fromkeys(wanted)), told)
    return tables


def check_clocks(tables: Tables, log: LogMapping) -> str:
    """Raise RecordingError where files cannot count one clock; otherwise a note on when each begins and ends, ""
    for one file."""
    spans = _spans(tables, log)
    if len(spans) < 2 or log.join is not None:
        return ""
    told = ", ".join(f"{name} {first:.6g} to {last:.6g} s" for name, (first, last) in spans.items())
    where = ", ".join(dict.fromkeys(str(table.path) for table in tables.values()))
    advice = "If they count different clocks, say `join`: a signal that is in both files shows how far they are apart."
    begin, end = max(first for first, _ in spans.values()), min(last for _, last in spans.values())
    shortest = min(last - first for first, last in spans.values())
    if end - begin < 0.5 * shortest:
        raise RecordingError(f"{where}: the stamps of these files hardly overlap ({told}). {advice}")
    if not log.one_clock and all(first == 0 for first, _ in spans.values()):
        raise RecordingError(
            f"{where}: the stamps of each file begin at 0, as they do where each counts from its own beginning. "
            f"{advice} If it is one clock, say one_clock: true."
        )
    return told


def received_apart(tables: Tables) -> str:
    """A note where topics were received at other times after what their stamps say: not all of them count one clock,
    or one is stamped when it was measured and another when it was sent on; "" elsewhere."""
    after = {source.topic or "the mapping's topic": one.received_after for source, one in tables.items()}
    known = {topic: seconds for topic, seconds in after.items() if seconds is not None}
    if not known or max(known.values()) - min(known.values()) < RECEIVED_APART:
        return ""
    told = ", ".join(f"{topic} {seconds:+.3f} s" for topic, seconds in known.items())
    return f"{told} after their stamps: are they of one clock? `hts data lag` tells; log_time is one for all"


def _spans(tables: Tables, log: LogMapping) -> dict[str, tuple[float, float]]:
    """First and last stamp of each file, s."""
    spans: dict[str, tuple[float, float]] = {}
    scale = SECONDS[log.time.unit]
    for source, table in tables.items():
        first, last = float(table.stamps[0]) * scale, float(table.stamps[-1]) * scale
        name = source.file or ""
        known = spans.get(name, (np.inf, -np.inf))
        spans[name] = (min(first, known[0]), max(last, known[1]))
    return spans
