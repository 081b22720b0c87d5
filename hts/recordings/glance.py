"""A first look into a log, without a mapping: which columns it has, and what their first values are."""

from __future__ import annotations

import csv
import re
import zipfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from hts.errors import RecordingError
from hts.recordings.arrow import needs_pyarrow
from hts.recordings.encoding import not_plain, not_utf8
from hts.recordings.messages import fields_of, messages, topics
from hts.recordings.table import cannot_be_read

MOST_ROWS = 5000
MOST_LINE = 1 << 20
NAMED = re.compile(r"[^\[\].\d][^\[\].]{0,99}")
"""A name of an entry that a mapping may use in its place: `position[left_knee]`."""


@dataclass(frozen=True)
class Glance:
    """reader: which one reads it; columns: name -> first values, (rows,) or (rows, k) float64, NaN where there is no
    number; keys: what else the mapping must say, such as {"header": False}; dates: columns that hold dates."""

    reader: str
    columns: dict[str, np.ndarray]
    keys: dict[str, Any] = field(default_factory=dict)
    dates: tuple[str, ...] = ()


def glance(path: Path) -> Glance:
    """The columns of a log of any format that comes with hts, told apart by the file's content or ending.

    Raises RecordingError for a file that cannot be read, or is of none of these formats.
    """
    if path.exists() and not (path.is_file() or path.is_dir()):
        raise RecordingError(f"{path}: a pipe or a device, expected a file. Write the log to a file first.")
    try:
        return _reader_of(path)(path)
    except OSError as error:
        raise cannot_be_read(path, error) from error
    except (ValueError, LookupError, csv.Error) as error:
        if isinstance(error, UnicodeDecodeError) and (why := not_utf8(path)):
            raise RecordingError(f"{path}: {why}") from error
        what = " ".join(str(error).split())
        raise RecordingError(
            f"{path}: not a log of a known format ({what:.160}). Write its mapping by hand."
        ) from error


def _reader_of(path: Path) -> Callable[[Path], Glance]:
    if path.is_dir():
        return _lerobot if (path / "meta" / "info.json").exists() else _ros
    with path.open("rb") as file:
        begin = file.read(16)
    known: Mapping[bytes, Callable[[Path], Glance]] = {
        b"PAR1": _parquet,
        b"PK\x03\x04": _npz,
        b"\x89MCAP": _ros,
        b"SQLite format 3": _ros,
        b"#ROSBAG V": _ros,
    }
    return next((reader for magic, reader in known.items() if begin.startswith(magic)), _csv)


def _csv(path: Path) -> Glance:
    if why := not_plain(path):
        raise RecordingError(f"{path}: {why}")
    with path.open(encoding="utf-8-sig", errors="strict", newline="") as file:
        lines = list(islice(iter(lambda: file.readline(MOST_LINE), ""), MOST_ROWS))
    if not lines:
        raise RecordingError(f"{path}: empty. Expected a log.")
    delimiter = max(",;\t", key=lambda one: _steadiness(lines[:50], one))
    delimiter = delimiter if _steadiness(lines[:50], delimiter) else " "
    rows = [row for row in csv.reader(lines, delimiter=delimiter) if row]
    width = max(len(row) for row in rows[: max(len(rows) // 2, 1) + 20])
    preamble = next((count for count, row in enumerate(rows) if len(row) == width), 0)
    rows = rows[preamble:]
    keys: dict[str, Any] = {"preamble": preamble} if preamble else {}
    if delimiter != ",":
        keys["delimiter"] = delimiter
    decimal = "," if delimiter != "," and any("," in cell for row in rows[1:4] for cell in row) else "."
    if decimal == ",":
        keys["decimal"] = ","
    header = not any(_is_number(cell, decimal) for cell in rows[0])
    if not header:
        keys["header"] = False
    names = rows[0] if header else [str(count) for count in range(width)]
    body = rows[1:] if header else rows
    if header and body and not any(_is_number(cell, decimal) for cell in body[0]) and any(body[0]):
        keys["units_row"] = True
        body = body[1:]
    body = [row for row in body if len(row) == width]
    columns = {name: np.array([_number(row[at], decimal) for row in body]) for at, name in enumerate(names)}
    dates = tuple(name for at, name in enumerate(names) if body and _is_date(body[0][at]))
    return Glance("csv", columns, keys, dates)


def _steadiness(lines: list[str], delimiter: str) -> int:
    """How many lines have the count of delimiters that most lines have, 0 if that is none."""
    counts = [line.count(delimiter) for line in lines]
    most = max(set(counts), key=lambda one: (counts.count(one), one))
    return counts.count(most) if most else 0


def _is_number(cell: str, decimal: str) -> bool:
    return not np.isnan(_number(cell, decimal))


def _number(cell: str, decimal: str) -> float:
    try:
        return float(cell.replace(decimal, "."))
    except ValueError:
        return float("nan")


def _is_date(cell: str) -> bool:
    return len(cell) >= 10 and cell[4:5] == "-" and cell[7:8] == "-" and cell[:4].isdecimal()


def _parquet(path: Path) -> Glance:
    needs_pyarrow(path)
    import pyarrow as pa
    from pyarrow import parquet

    try:
        with path.open("rb") as opened, parquet.ParquetFile(opened) as file:
            batch = next(file.iter_batches(batch_size=MOST_ROWS, use_threads=False))
    except (pa.ArrowException, StopIteration) as error:
        raise RecordingError(f"{path}: not a whole Parquet file. Copy it again.") from error
    columns, dates = {}, []
    for name in batch.schema.names:
        column = batch.column(name)
        if pa.types.is_timestamp(column.type):
            dates.append(name)
            columns[name] = np.full(len(column), np.nan)
        elif isinstance(column, (pa.ListArray, pa.LargeListArray, pa.FixedSizeListArray)):
            columns[name] = _rectangle(column.to_pylist())
        elif pa.types.is_integer(column.type) or pa.types.is_floating(column.type):
            columns[name] = np.asarray(column.cast(pa.float64(), safe=False).to_numpy(zero_copy_only=False))
    return Glance("parquet", columns, {}, tuple(dates))


def _rectangle(rows: list[Any]) -> np.ndarray:
    sizes = {len(row) for row in rows if row is not None}
    if len(sizes) != 1:
        return np.full(len(rows), np.nan)
    size = sizes.pop()
    return np.array([row if row is not None else [None] * size for row in rows], dtype=np.float64)


def _npz(path: Path) -> Glance:
    from hts.recordings.npz_reader import read_array

    try:
        with zipfile.ZipFile(path) as file:
            arrays = {
                one.filename.removesuffix(".npy"): read_array(path, one.filename, file, one) for one in file.infolist()
            }
    except zipfile.BadZipFile as error:
        raise RecordingError(f"{path}: not a whole NPZ file. Copy it again.") from error
    plain = {name: one[:MOST_ROWS].astype(np.float64) for name, one in arrays.items() if one.ndim in (1, 2)}
    return Glance("npz", plain, {}, tuple(name for name, one in arrays.items() if one.dtype.kind == "M"))


def _lerobot(path: Path) -> Glance:
    from hts.recordings.lerobot_reader import data_files, names_of, read_info

    info = read_info(path)
    found: dict[str, np.ndarray] = {}
    for name, values in _parquet(data_files(path)[0]).columns.items():
        names = names_of(info["features"].get(name))
        if values.ndim == 2 and len(names) == values.shape[1]:
            found |= {f"{name}[{one}]": values[:, at] for at, one in enumerate(names)}
        else:
            found[name] = values
    return Glance("lerobot", found, {"rate_hz": float(info["fps"])})


def _ros(path: Path) -> Glance:
    kinds = topics(path)
    best: tuple[str, list[Any], list[int]] = ("", [], [])
    for topic in sorted(kinds)[:50]:
        try:
            some = list(islice(messages(path, topic, {}), 200))
        except RecordingError:  # a topic without a definition in the file
            continue
        if len(_leaves(some[0].content) if some else ()) > len(_leaves(best[1][0]) if best[1] else ()):
            best = (topic, [one.content for one in some], [one.log_time for one in some])
    if not best[1]:
        listed = ", ".join(f"{topic} ({kind})" for topic, kind in sorted(kinds.items()))
        raise RecordingError(
            f"{path}: no topic can be decoded with what the file says of itself: {listed or 'it has none'}."
        )
    topic, contents, stamps = best
    rows = [_leaves(content) for content in contents]
    names = [name for name in rows[0] if all(name in row for row in rows)]
    columns = {name: np.array([row[name] for row in rows], dtype=np.float64) for name in names}
    return Glance("ros", {"log_time": np.array(stamps, dtype=np.float64), **columns}, {"topic": topic})


def _leaves(content: Any, prefix: str = "") -> dict[str, float]:
    """Every number in a message, by its path; entries of lists by name where the message has as many, as a JointState
    has, since their order is the sender's."""
    found: dict[str, float] = {}
    given = content.name if "name" in fields_of(content) and isinstance(content.name, list) else []
    names = given if all(NAMED.fullmatch(str(one)) for one in given) else []
    for name in fields_of(content):
        value = getattr(content, name)
        path = f"{prefix}{name}"
        if isinstance(value, (bool, int, float)):
            found[path] = float(value)
        elif isinstance(value, (list, bytes, tuple)) and len(value) <= 64:
            for at, one in enumerate(value):
                if isinstance(one, (bool, int, float)):
                    found[f"{path}[{names[at] if len(names) == len(value) else at}]"] = float(one)
                elif not isinstance(one, str):
                    found |= _leaves(one, f"{path}[{at}].")
        elif not isinstance(value, (str, bytes)):
            found |= _leaves(value, f"{path}.")
    return found
