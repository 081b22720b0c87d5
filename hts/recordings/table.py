"""Columns of one log file with their time stamps: whole rows, increasing time, nothing infinite."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hts.errors import RecordingError, unknown_name

ColumnName = str | int

DATES = "iso"
"""The unit of stamps that are dates and times instead of numbers."""
AGAIN = "Copy the log again if not all of it came over, or record it again."


@dataclass(frozen=True, eq=False)
class Table:
    """stamps: (rows,) as in the file, increasing, integers kept exact; columns: (rows,) float64, NaN where empty;
    empty_rows: how many were left out because nothing but their time was in them; last_line: what is to be noted of a
    last line of the file that has no end; last_line_dropped: whether it was left out, or kept; received_after: s by
    which its recorder's clock was past the stamps when rows were received, the median; None where nobody noted it."""

    path: Path
    stamps: np.ndarray
    columns: dict[ColumnName, np.ndarray]
    empty_rows: int
    last_line: str = ""
    last_line_dropped: bool = False
    received_after: float | None = None

    def rows(self, kept: np.ndarray) -> Table:
        """The same with some of the rows. kept: (rows,) bool, or their numbers."""
        columns = {name: values[kept] for name, values in self.columns.items()}
        at_end = len(self.stamps) - 1 in np.arange(len(self.stamps))[kept]
        note = self.last_line if at_end else ""
        return Table(self.path, self.stamps[kept], columns, self.empty_rows, note, self.last_line_dropped)


def cannot_be_read(path: Path, error: OSError) -> RecordingError:
    """What to raise for a file that the system does not give."""
    return RecordingError(f"{path}: cannot be read ({error.strerror or error}). Correct the path.")


def row_of_data(index: int) -> str:
    """What messages call a row of a file that has no lines: its number, from 1. index: from 0."""
    return f"row {index + 1} of the data"


def table_of(
    path: Path,
    time: ColumnName,
    unit: str,
    wanted: Sequence[ColumnName],
    columns: Mapping[Any, Any],
    run: ColumnName | None = None,
) -> Table:
    """The time column and those wanted, out of all columns of a file.

    columns: name -> (rows,) numbers, None or NaN where there is none; integers of the time column are kept exact.
    unit: of the stamps; "iso" for numpy's datetime64, which become whole nanoseconds; run: as in `whole_rows`.
    Raises RecordingError naming file, column and row.
    """
    for column in (time, *wanted):
        if column not in columns:
            raise RecordingError(f"{path}: {no_column(str(column), [str(name) for name in columns])}")
    stamps, there = _stamps(path, time, unit, np.asarray(columns[time]))
    values = {column: _numbers(path, column, columns[column], len(there)) for column in wanted}
    return whole_rows(path, time, stamps, there, values, run, unit=unit)


def whole_rows(
    path: Path,
    time: ColumnName,
    stamps: np.ndarray,
    there: np.ndarray,
    columns: dict[ColumnName, np.ndarray],
    run: ColumnName | None = None,
    place: Callable[[int], str] = row_of_data,
    unit: str = "",
) -> Table:
    """A table without the rows in which there is nothing but a time.

    stamps: those that are there, in order; there: (rows,) bool, which rows have one; columns: (rows,) float64;
    run: the column among them that numbers the runs of the file, each of which has a clock that may begin anew;
    place: what messages call a row, from its index; unit: of the stamps, so that messages show dates as such.
    Raises RecordingError for infinite numbers, data without a time, time that does not increase, less than two rows.
    """
    if not len(there):
        raise RecordingError(f"{path}: no row of data stands in it. {AGAIN}")
    if not there.any():
        raise RecordingError(f"{path}: no row has a time in column '{time}'. Expected a log; correct the mapping.")
    filled = np.zeros(len(there), dtype=np.bool_)
    for column, values in columns.items():
        infinite = np.isinf(values)
        if infinite.any():
            raise RecordingError(
                f"{path}: column '{column}' is infinite in {place(int(np.argmax(infinite)))}. "
                "Repair the log or cut it there."
            )
        filled |= ~np.isnan(values)
    if (filled & ~there).any():
        where = place(int(np.argmax(filled & ~there)))
        raise RecordingError(
            f"{path}: {where} has data but no time in column '{time}'. Repair the log or remove it there."
        )
    rows = np.flatnonzero(filled)
    if len(rows) < 2:
        raise RecordingError(
            f"{path}: {len(rows)} rows with data in the mapped columns. Expected a log; correct the mapping."
        )
    kept = stamps[filled[there]]
    back = ~(kept[1:] > kept[:-1])
    if run is not None:
        number = columns[run][rows]
        if np.isnan(number).any():
            where = place(int(rows[np.argmax(np.isnan(number))]))
            raise RecordingError(f"{path}: {where} has no number in '{run}', the column of runs. Repair the log.")
        back &= number[1:] == number[:-1]
    back = np.flatnonzero(back)
    if len(back):
        at = int(back[0])
        raise RecordingError(
            f"{path}: time does not increase in {place(int(rows[at + 1]))}: column '{time}' reads "
            f"{_shown(kept[at], unit)}, then {_shown(kept[at + 1], unit)}. {_mended(kept[at] - kept[at + 1], unit)}, "
            "or name another time column."
        )
    if len(rows) < len(there):
        columns = {column: values[rows] for column, values in columns.items()}
    return Table(path, kept, columns, len(there) - len(rows))


def _shown(stamp: np.generic, unit: str) -> str:
    """A stamp as a person wrote it: dates are kept as whole nanoseconds."""
    if unit != DATES:
        return str(stamp)
    return str(np.datetime64(int(stamp), "ns")).rstrip("0").rstrip(".").replace("T", " ")


def _mended(step: np.generic, unit: str) -> str:
    """What to do about stamps that go back by so much, in their unit; those of dates are in ns."""
    if step == 0:
        return (
            "Two rows share a stamp: take out the one that is a copy, or write stamps with more digits (float32 has "
            "seven)"
        )
    if unit == DATES and abs(int(step) * 1e-9 - 3600) < 60:
        return (
            "That is an hour: local time was probably put back there (the end of daylight saving). Log in UTC, or add "
            "an hour from there on"
        )
    return "Sort rows that are out of order; where the clock was set back, cut the log there, since sorting mixes them"


def no_column(name: str, names: Sequence[str]) -> str:
    """What to say of a column that is not there: the closest, and the first forty that are."""
    shown = list(names) if len(names) <= 40 else [*names[:40], f"… {len(names) - 40} more"]
    hint = unknown_name("column", name, names).split(" Known: ", maxsplit=1)[0]
    return f"{hint} The file has: {', '.join(shown)}."


def place_of(path: Path, column: str, names: Sequence[str]) -> tuple[str, int | None]:
    """Which of the file's own columns is meant, and which entry of its lists: `q[3]` is the fourth of `q`. Raises
    RecordingError for one that is not there."""
    if column in names:
        return column, None
    entry = re.fullmatch(r"(.+)\[(\d{1,6})\]", column)
    if entry is not None and entry[1] in names:
        return entry[1], int(entry[2])
    raise RecordingError(f"{path}: {no_column(column, names)}")


def not_a_time(path: Path, time: ColumnName, unit: str, first: object, how: str = "it begins with") -> RecordingError:
    """The error for stamps that are not what the mapping says. first: one that is not, found as `how` says."""
    if unit == DATES:
        return RecordingError(
            f"{path}: time column '{time}' does not hold dates and times such as 2026-03-01T12:00:00.020 "
            f"({how} {first!r:.60}), but time.unit says {DATES}. Say s, ms, us or ns for numbers."
        )
    return RecordingError(
        f"{path}: time column '{time}' does not hold numbers ({how} {first!r:.60}). "
        f"Name the column with stamps in s, ms, us or ns, or say unit: {DATES} for dates and times."
    )


def _stamps(path: Path, time: ColumnName, unit: str, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Stamps that are there, integers as integers, and (rows,) bool which rows have one."""
    if values.dtype.kind == "M" and unit == DATES:
        there = ~np.isnat(values)
        return values[there].astype("datetime64[ns]").astype(np.int64), there
    if values.ndim != 1 or values.dtype.kind not in "iufO" or unit == DATES:
        raise not_a_time(path, time, unit, str(values.flat[0]) if values.size else "")
    if values.dtype.kind in "iu":
        return values, np.ones(len(values), dtype=np.bool_)
    if values.dtype.kind == "O":
        there = np.array([value is not None for value in values], dtype=np.bool_)
        present = np.array([value for value in values if value is not None])
        if present.dtype.kind not in "iuf":
            raise not_a_time(path, time, unit, values[int(np.argmax(there))])
        if present.dtype.kind in "iu":
            return present, there
    numbers = _numbers(path, time, values, len(values))
    there = ~np.isnan(numbers)
    return numbers[there], there


def _numbers(path: Path, column: ColumnName, values: Any, rows: int) -> np.ndarray:
    try:
        numbers = np.asarray(values, dtype=np.float64)  # None becomes NaN
    except (TypeError, ValueError) as error:
        text = " ".join(str(error).split())
        raise RecordingError(f"{path}: column '{column}' does not hold numbers ({text:.80}). Name another.") from error
    if numbers.shape != (rows,):
        raise RecordingError(
            f"{path}: column '{column}' has shape {numbers.shape} for {rows} rows. Expected one number a row."
        )
    return numbers
