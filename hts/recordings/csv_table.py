"""The wanted columns of one comma-separated file, as arrays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hts.errors import RecordingError, unknown_name

MISSING = ["", "nan", "NaN", "NAN", "-nan", "NA", "N/A", "null", "NULL", "None"]


@dataclass(frozen=True)
class Table:
    """stamps: (rows,) as in the file, increasing, integers kept exact; columns: (rows,) float64, NaN where empty."""

    path: Path
    stamps: np.ndarray
    columns: dict[str | int, np.ndarray]
    empty_rows: int


def read_table(path: Path, time: str | int, wanted: Sequence[str | int], header: bool, delimiter: str) -> Table:
    """Read the time column and those wanted; rows that are empty but for the time are dropped.

    Without a header line columns are numbers from 0. Raises RecordingError naming file, column and row
    (the first row of data is row 1).
    """
    import pyarrow as pa
    from pyarrow import csv

    reading = csv.ReadOptions(autogenerate_column_names=not header, use_threads=False)
    parsing = csv.ParseOptions(delimiter=delimiter)
    try:
        with csv.open_csv(path, read_options=reading, parse_options=parsing) as opened:
            names = opened.schema.names
        time_name = _column(path, time, names, header)
        by_column = {column: _column(path, column, names, header) for column in wanted}
        types = {name: pa.float64() for name in by_column.values() if name != time_name}
        converting = csv.ConvertOptions(
            include_columns=list(dict.fromkeys([time_name, *by_column.values()])),
            column_types=types,
            null_values=MISSING,
            strings_can_be_null=True,
        )
        table = csv.read_csv(path, read_options=reading, parse_options=parsing, convert_options=converting)
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read ({error.strerror or error}). Correct the path.") from error
    except (pa.ArrowInvalid, UnicodeDecodeError) as error:
        what = " ".join(str(error).split())
        raise RecordingError(
            f"{path}: not the table that the mapping describes: {what}. Repair the file or the mapping."
        ) from error
    stamps = table.column(time_name)
    if stamps.null_count == len(stamps):
        raise RecordingError(f"{path}: no row has a time in column '{time}'. Expected a log; correct the mapping.")
    if not (pa.types.is_integer(stamps.type) or pa.types.is_floating(stamps.type)):
        raise RecordingError(
            f"{path}: time column '{time}' does not hold numbers (it begins with {stamps.drop_null()[0].as_py()!r}). "
            "Name the column with stamps in s, ms, us or ns."
        )
    columns = {column: _values(path, column, table.column(name)) for column, name in by_column.items()}
    return _without_empty_rows(path, time, stamps, columns)


def _values(path: Path, column: str | int, chunked: object) -> np.ndarray:
    values = np.asarray(chunked.to_numpy(), dtype=np.float64)  # type: ignore[attr-defined]
    if np.isinf(values).any():
        row = int(np.argmax(np.isinf(values))) + 1
        raise RecordingError(f"{path}: column '{column}' is infinite in row {row}. Repair the log or cut it there.")
    return values


def _without_empty_rows(path: Path, time: str | int, stamps: object, columns: dict[str | int, np.ndarray]) -> Table:
    there = ~np.asarray(stamps.is_null().to_numpy(), dtype=np.bool_)  # type: ignore[attr-defined]
    filled = np.zeros(len(there), dtype=np.bool_)
    for values in columns.values():
        filled |= ~np.isnan(values)
    if (filled & ~there).any():
        row = int(np.argmax(filled & ~there)) + 1
        raise RecordingError(
            f"{path}: row {row} has data but no time in column '{time}'. Repair the log or remove the row."
        )
    rows = np.flatnonzero(filled)
    if len(rows) < 2:
        raise RecordingError(
            f"{path}: {len(rows)} rows with data in the mapped columns. Expected a log; correct the mapping."
        )
    kept = stamps.drop_null().to_numpy()[filled[there]]  # type: ignore[attr-defined]
    back = np.flatnonzero(~(kept[1:] > kept[:-1]))
    if len(back):
        at = int(back[0])
        raise RecordingError(
            f"{path}: time does not increase in row {rows[at + 1] + 1}: column '{time}' reads {kept[at]}, "
            f"then {kept[at + 1]}. Sort or repair the log, or name another time column."
        )
    return Table(path, kept, {column: values[rows] for column, values in columns.items()}, len(there) - len(rows))


def _column(path: Path, column: str | int, names: Sequence[str], header: bool) -> str:
    """The name pyarrow knows the column by."""
    if not header:
        if not isinstance(column, int) or not 0 <= column < len(names):
            raise RecordingError(
                f"{path}: no column {column!r}. Without a header line columns are numbers, 0 to {len(names) - 1}."
            )
        return names[column]
    name = str(column)
    if list(names).count(name) > 1:
        raise RecordingError(f"{path}: two columns are named '{name}'. Rename one in the file's first line.")
    if name not in names:
        shown = names if len(names) <= 40 else [*names[:40], f"… {len(names) - 40} more"]
        raise RecordingError(f"{path}: {_no_column(name, names, shown)}")
    return name


def _no_column(name: str, names: Sequence[str], shown: Sequence[str]) -> str:
    hint = unknown_name("column", name, names).split(" Known: ")[0]
    return f"{hint} The file has: {', '.join(shown)}."
