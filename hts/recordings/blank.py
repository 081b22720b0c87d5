"""Rows that a logger wrote before the first message came, or where one was lost: a struct of zeros.

Positions, velocities and torques of all joints are 0 to the last digit there, and a row earlier or later the joints are
elsewhere. A robot that lies at its zeros with idle motors may read so too, but it does not jump.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from hts.recordings.mapping import LogMapping
from hts.recordings.repeated import runs_of
from hts.recordings.sources import Source, Tables, source_of
from hts.recordings.table import ColumnName, Table

POSITION, BESIDE = "joint_position", ("joint_velocity", "joint_torque")
JUMP = 0.1
"""As a share of how far from 0 the farthest joint typically is: so far it does not move within a row."""


def without_blanks(
    tables: Tables, log: LogMapping, columns: Mapping[str, tuple[ColumnName, ...]]
) -> tuple[Tables, int]:
    """The tables with nothing but stamps in such rows, and how many these are. columns: of each channel."""
    found, count = dict(tables), 0
    run = log.runs.column if log.runs is not None else None
    for source, table in tables.items():
        blank = _blank(table, source, log, columns)
        if blank.any():
            kept = {name: v if name == run else np.where(blank, np.nan, v) for name, v in table.columns.items()}
            found[source] = replace(table, columns=kept)
            count += int(blank.sum())
    return found, count


def _blank(table: Table, source: Source, log: LogMapping, columns: Mapping[str, tuple[ColumnName, ...]]) -> np.ndarray:
    """Which rows (rows,) bool of a table hold nothing that was measured."""
    names = [name for name in (POSITION, *BESIDE) if name in log.channels and source_of(log.channels[name]) == source]
    blank = np.zeros(len(table.stamps), dtype=np.bool_)
    if POSITION not in names or len(names) < 2:
        return blank
    zero = np.logical_and.reduce([table.columns[column] == 0 for name in names for column in columns[name]])
    far = np.fmax.reduce([np.abs(table.columns[column]) for column in columns[POSITION]])
    elsewhere = far[~zero & np.isfinite(far)]
    if not zero.any() or not len(elsewhere):
        return blank
    least = JUMP * np.median(elsewhere)
    for first, end in runs_of(zero):
        beside = [far[at] for at in (first - 1, end) if 0 <= at < len(far)]
        blank[first:end] = min(beside) > least
    return blank
