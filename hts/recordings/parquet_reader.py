"""Parquet logs, read by a mapping (mapping.py) into a recording. Entries of a list column are `q[0]`, `q[1]`, …"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hts.errors import RecordingError
from hts.recordings.arrow import needs_pyarrow, numbers_of, stamps_of
from hts.recordings.logs import LogMapping, Table
from hts.recordings.table import ColumnName, cannot_be_read, place_of, whole_rows
from hts.recordings.table_reader import TableReader

if TYPE_CHECKING:
    from hts.contracts import LogReader, Settings


def make(settings: Settings) -> LogReader:
    """Factory of the log reader `parquet`."""
    return TableReader(settings, read_table, LogMapping)


def read_table(path: Path, wanted: Sequence[ColumnName], log: LogMapping) -> Table:
    """The time column and those wanted. Raises RecordingError naming file, column and row."""
    needs_pyarrow(path)
    import pyarrow as pa
    from pyarrow import parquet

    time = str(log.time.column)
    try:
        with path.open("rb") as opened, parquet.ParquetFile(opened) as file:
            names = file.schema_arrow.names
            found = {column: place_of(path, str(column), names) for column in (time, *wanted)}
            table = file.read(columns=sorted({name for name, _ in found.values()}), use_threads=False)
    except (pa.ArrowException, OSError) as error:
        if isinstance(error, OSError) and error.errno is not None:  # pyarrow raises OSError for damaged files, too
            raise cannot_be_read(path, error) from error
        what = " ".join(str(error).split())
        raise RecordingError(f"{path}: not a whole Parquet file ({what:.200}). Copy it again.") from error
    if len(set(names)) != len(names):
        raise RecordingError(f"{path}: two of its columns have one name. Rename one.")
    picked = {column: _picked(path, column, table.column(name), entry) for column, (name, entry) in found.items()}
    stamps, there = stamps_of(path, time, log.time.unit, picked[time])
    columns = {column: numbers_of(path, column, picked[column]) for column in wanted}
    return whole_rows(path, time, stamps, there, columns, log.runs.column if log.runs else None, unit=log.time.unit)


def _picked(path: Path, column: ColumnName, chunked: Any, entry: int | None) -> Any:
    """The column, or one entry of the lists in it; nothing where a row has no list."""
    import pyarrow as pa
    from pyarrow import compute

    kind = chunked.type
    lists = pa.types.is_list(kind) or pa.types.is_large_list(kind) or pa.types.is_fixed_size_list(kind)
    if entry is None:
        if lists:
            raise RecordingError(f"{path}: column '{column}' holds lists. Name their entries: '{column}[0..11]'.")
        return chunked
    if not lists:
        raise RecordingError(f"{path}: '{column}' is an entry of a list, but the column holds {kind}. Name it alone.")
    try:
        return compute.list_element(chunked, entry)
    except (pa.ArrowInvalid, IndexError) as error:
        raise RecordingError(f"{path}: '{column}' is not in every row: some lists are shorter. Name others.") from error
