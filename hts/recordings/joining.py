"""Two files of one run with clocks of their own, brought to one clock by a signal that both hold."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from hts.errors import ConfigError, RecordingError
from hts.recordings.clocks import ClockOffset, clock_offset
from hts.recordings.factors import common_factor, common_offset, names_joints
from hts.recordings.mapping import LogMapping
from hts.recordings.sources import Source, Tables, source_of
from hts.recordings.table import ColumnName

FASTEST_HZ = 200.0
"""At which signals are compared; a peak is found to a fraction of a sample."""


def joined(
    times: Mapping[Source, np.ndarray],
    tables: Tables,
    log: LogMapping,
    columns: Mapping[str, tuple[ColumnName, ...]],
) -> tuple[dict[Source, np.ndarray], ClockOffset]:
    """Times on the clock of the file that stays, and how far the other was moved.

    times: of each table's rows, s after its own first stamp. Raises RecordingError where no offset is trustworthy.
    """
    assert log.join is not None
    signals: list[tuple[np.ndarray, np.ndarray]] = []
    for name in (log.join.match, log.join.channel):
        one = log.channels[name]
        source = source_of(one)
        values = np.stack([tables[source].columns[column] for column in columns[name]], axis=1)
        if names_joints(one):
            raise ConfigError(
                f"Mapping: join: '{name}' has a sign, scale or offset of single joints. Name another channel."
            )
        values = common_factor(one) * values + common_offset(one)
        there = np.isfinite(values).all(axis=1)
        if there.sum() < 8:
            raise RecordingError(f"{tables[source].path}: '{name}' holds too few numbers to join two clocks by.")
        signals.append((times[source][there], values[there]))
    rate = min(FASTEST_HZ, *(1.0 / float(np.median(np.diff(one))) for one, _ in signals))
    try:
        offset = clock_offset(*signals[0], *signals[1], rate)
    except RecordingError as error:
        paths = ", ".join(
            str(tables[source_of(log.channels[name])].path) for name in (log.join.match, log.join.channel)
        )
        raise RecordingError(f"{paths}: join: {error}") from error
    moved = {source: one + offset.seconds if source.file == log.join.file else one for source, one in times.items()}
    earliest = min(one[0] for one in moved.values())
    return {source: one - earliest for source, one in moved.items()}, offset
