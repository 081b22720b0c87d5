"""From columns as pyarrow reads them to the arrays of a table."""

from __future__ import annotations

from contextlib import suppress
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from hts.errors import RecordingError
from hts.recordings.table import DATES, ColumnName, not_a_time


def needs_pyarrow(path: Path) -> None:
    """Raises RecordingError, one line, where pyarrow is not installed."""
    if find_spec("pyarrow") is None:
        raise RecordingError(f"{path}: reading it needs pyarrow, which is not installed. `pip install pyarrow`.")


def stamps_of(path: Path, time: ColumnName, unit: str, column: Any) -> tuple[np.ndarray, np.ndarray]:
    """Stamps that are there, integers kept exact, and (rows,) bool which rows have one; dates are in ns.

    column: a ChunkedArray; unit: of the stamps, as the mapping has it. Raises RecordingError for other things.
    """
    import pyarrow as pa

    column = _dates(column) if unit == DATES else column
    there = ~np.asarray(column.is_null().to_numpy(), dtype=np.bool_)
    present = column.drop_null()
    kind, dates = column.type, pa.types.is_timestamp(column.type)
    numbers = pa.types.is_integer(kind) or pa.types.is_floating(kind)
    if (len(present) and dates != (unit == DATES)) or not (dates or numbers or not len(present)):
        odd = _odd(present, unit)
        raise not_a_time(path, time, unit, *((_first(present),) if odd is None else (odd, "in a later row")))
    if dates:
        present = present.cast(pa.timestamp("ns", tz=kind.tz)).cast(pa.int64())
    values = present.to_numpy()
    if values.dtype.kind == "f" and np.isnan(values).any():
        there[there] = ~np.isnan(values)
        values = values[~np.isnan(values)]
    return values, there


def numbers_of(path: Path, column: ColumnName, chunked: Any) -> np.ndarray:
    """A column as (rows,) float64, NaN where it is empty. Raises RecordingError if it holds no numbers."""
    import pyarrow as pa

    kind = chunked.type
    if not (pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_boolean(kind) or kind == pa.null()):
        raise RecordingError(f"{path}: column '{column}' holds {kind}, not numbers. Correct the mapping.")
    return np.asarray(chunked.cast(pa.float64(), safe=False).to_numpy(), dtype=np.float64)


def _dates(column: Any) -> Any:
    """A column, or a scalar, of dates that are written as text, as dates; any other as it is."""
    import pyarrow as pa

    if pa.types.is_string(column.type) or pa.types.is_large_string(column.type):
        for zone in (None, "UTC"):  # the first takes dates without a zone only, the second those with one
            with suppress(pa.ArrowInvalid):
                return column.cast(pa.timestamp("ns", zone))
    return column


def _odd(column: Any, unit: str) -> str | None:
    """The first text in it that is no such stamp as stand before it; None where the first is none, or nothing is text.

    unit: of the stamps.
    """
    import pyarrow as pa

    if not (pa.types.is_string(column.type) or pa.types.is_large_string(column.type)):
        return None
    kind = _dates(column[0]).type if unit == DATES else pa.float64()
    for at, text in enumerate(column if kind != column.type else ()):
        try:
            text.cast(kind)
        except pa.ArrowInvalid:
            return str(text) if at else None
    return None


def _first(column: Any) -> str:
    """The first value as it would be written; dates finer than Python's have no Python value."""
    import pyarrow as pa

    try:
        return str(column[:1].cast(pa.string())[0].as_py())
    except pa.ArrowException:  # a list or a mapping
        return str(column.type)
