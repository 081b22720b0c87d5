"""NPZ logs: arrays by name in one file, one row a time step. Entries of a second axis are `q[0]`, `q[1]`, ….

An array is read where it holds numbers or dates, and after its size was compared with what the file says of it: an
array of objects would be code, and a few bytes can announce any amount of memory.
"""

from __future__ import annotations

import math
import zipfile
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

import numpy as np

from hts.errors import RecordingError
from hts.recordings.logs import LogMapping, Table, table_of
from hts.recordings.table import ColumnName, cannot_be_read, place_of
from hts.recordings.table_reader import TableReader

if TYPE_CHECKING:
    from hts.contracts import LogReader, Settings

MOST_BYTES = 1 << 30
"""Of one array: a hundred numbers at 1 kHz for twenty minutes."""
UNPACKED = 1 << 26
"""Bytes from which on an array that was squeezed more than `MOST_SQUEEZED` times is no log."""
MOST_SQUEEZED = 100


def make(settings: Settings) -> LogReader:
    """Factory of the log reader `npz`."""
    return TableReader(settings, read_table, LogMapping)


def read_table(path: Path, wanted: Sequence[ColumnName], log: LogMapping) -> Table:
    """The time column and those wanted. Raises RecordingError naming file, array and row."""
    time = log.time.column
    try:
        with zipfile.ZipFile(path) as file:
            members = {name.removesuffix(".npy"): one for one in file.infolist() if (name := one.filename)}
            places = {column: place_of(path, str(column), list(members)) for column in (time, *wanted)}
            # In their order, so that which of two faults is told hangs on no hash.
            names = dict.fromkeys(name for name, _ in places.values())
            arrays = {name: read_array(path, name, file, members[name]) for name in names}
    except OSError as error:
        raise cannot_be_read(path, error) from error
    except (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, RuntimeError, ValueError) as error:
        what = " ".join(str(error).split()) or type(error).__name__
        raise RecordingError(f"{path}: not a whole NPZ file ({what:.160}). Copy it again.") from error
    columns = {column: _entry(path, arrays[name], name, entry) for column, (name, entry) in places.items()}
    for column, values in columns.items():
        if len(values) != len(columns[time]):
            raise RecordingError(
                f"{path}: '{column}' has {len(values)} rows, the time '{time}' {len(columns[time])}. Expected one row "
                "of each a time step; name another."
            )
    return table_of(path, time, log.time.unit, wanted, columns, log.runs.column if log.runs else None)


def read_array(path: Path, name: str, file: zipfile.ZipFile, member: zipfile.ZipInfo) -> np.ndarray:
    """One array, once its header promises no more than the file holds. Raises RecordingError."""
    with file.open(member) as opened:
        shape, dtype, header = _header(path, name, opened)
        size = math.prod(shape) * dtype.itemsize
        if size > MOST_BYTES:
            raise RecordingError(
                f"{path}: '{name}' of shape {shape} has {size:.3g} bytes, at most {MOST_BYTES:.3g} are read."
            )
        if header + size != member.file_size:
            raise RecordingError(
                f"{path}: '{name}' says it is {dtype} of shape {shape}, {size} bytes, but {member.file_size - header} "
                "are there. The file is damaged; copy it again."
            )
        if size > UNPACKED and size > MOST_SQUEEZED * member.compress_size:
            raise RecordingError(
                f"{path}: '{name}' of {size:.3g} bytes was squeezed into {member.compress_size:.3g}, as no log can be. "
                "If it is right, save it again with numpy.savez."
            )
    with file.open(member) as opened:
        return np.asarray(np.lib.format.read_array(opened, allow_pickle=False))


def _header(path: Path, name: str, opened: IO[bytes]) -> tuple[tuple[int, ...], np.dtype[Any], int]:
    """Shape, type and length of the header, bytes, of an array that is numbers or dates."""
    version = np.lib.format.read_magic(opened)
    read = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}.get(version)
    if read is None:
        raise ValueError(f"'{name}' is of version {version}, expected 1.0 or 2.0")
    shape, _, dtype = read(opened)
    if dtype.hasobject or dtype.kind not in "iufbM":
        raise RecordingError(
            f"{path}: '{name}' holds {dtype}, not numbers; arrays of objects are never opened, since they may be code. "
            "Name another, or save it as numbers."
        )
    return shape, dtype, opened.tell()


def _entry(path: Path, values: np.ndarray, name: str, entry: int | None) -> np.ndarray:
    if values.ndim == 1 and entry is None:
        return values
    if values.ndim != 2:
        raise RecordingError(
            f"{path}: '{name}' has shape {values.shape}. Expected (rows,), or (rows, numbers) of which '{name}[0]' "
            "is one."
        )
    if entry is None:
        if values.shape[1] != 1:
            raise RecordingError(
                f"{path}: '{name}' has {values.shape[1]} numbers a row. Name its entries: "
                f"'{name}[0..{values.shape[1] - 1}]'."
            )
        return values[:, 0]
    if entry >= values.shape[1]:
        raise RecordingError(f"{path}: no '{name}[{entry}]': it has {values.shape[1]} numbers a row, counted from 0.")
    return values[:, entry]
