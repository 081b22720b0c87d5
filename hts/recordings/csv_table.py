"""The wanted columns of one comma-separated file, as arrays."""

from __future__ import annotations

import io
import itertools
import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

from hts.errors import RecordingError
from hts.recordings.arrow import needs_pyarrow, numbers_of, stamps_of
from hts.recordings.csv_end import Unended, number_of, of_last_line, unended_line
from hts.recordings.encoding import escaped, in_place, not_plain, not_utf8
from hts.recordings.table import AGAIN, ColumnName, Table, cannot_be_read, no_column, row_of_data, whole_rows

if TYPE_CHECKING:
    from hts.recordings.csv_reader import CsvMapping

DELIMITERS = ";\t|,"
MOST_TEXT = 100  # lines before a table
MISSING = ["", "nan", "NaN", "NAN", "-nan", "NA", "N/A", "null", "NULL", "None"]


def read_table(path: Path, wanted: Sequence[ColumnName], log: CsvMapping) -> Table:
    """Read the time column and those wanted; rows that are empty but for the time are dropped, and so is a last line
    that is cut off (csv_end.py).

    Without a header line columns are numbers from 0. Raises RecordingError naming file, column and line of the file.
    """
    needs_pyarrow(path)
    import pyarrow as pa
    from pyarrow import csv

    time = log.time.column
    reading = csv.ReadOptions(
        autogenerate_column_names=not log.header,
        skip_rows=log.preamble,
        skip_rows_after_names=int(log.units_row),
        use_threads=False,
    )
    parsing = csv.ParseOptions(delimiter=log.delimiter)
    names: list[str] = []
    try:
        end, note, cut = unended_line(path, _before(log)), "", False
        # Opened here: pyarrow cannot take the name of a file that is no text.
        with (
            path.open("rb") as file,
            csv.open_csv(_until(file, end), read_options=reading, parse_options=parsing) as opened,
        ):
            names = opened.schema.names
        time_name = _column(path, time, names, log)
        by_column = {column: _column(path, column, names, log) for column in wanted}
        columns_read = list(dict.fromkeys([time_name, *by_column.values()]))

        def read(how: Callable[..., Any], end: Unended | None, **kinds: Any) -> Any:
            converting = csv.ConvertOptions(
                include_columns=columns_read,
                column_types={name: pa.float64() for name in columns_read if name != time_name} | kinds,
                null_values=MISSING,
                strings_can_be_null=True,
                decimal_point=log.decimal,
            )
            with path.open("rb") as file:
                text = _until(file, end)
                return how(text, read_options=reading, parse_options=parsing, convert_options=converting)

        if end is not None:
            note, cut = of_last_line(end, log, names, {time_name, *by_column.values()}, MISSING)
        # Stamps are left to pyarrow, which tells integers from others: that keeps nanoseconds exact. What they are is
        # taken from the first ones, since else it keeps the text of the whole file until it knows; later ones may be
        # of another kind.
        try:
            kind = read(csv.open_csv, end).schema.field(time_name).type
            table = read(csv.read_csv, end if cut else None, **{time_name: kind})
        except pa.ArrowInvalid:
            table = read(csv.read_csv, end if cut else None)
    except OSError as error:
        raise cannot_be_read(path, error) from error
    except RecordingError as error:  # a column that is not there: perhaps since nothing of it could be read
        raise (RecordingError(f"{path}: {why}") if (why := not_plain(path)) else error) from error
    except (pa.ArrowInvalid, UnicodeDecodeError) as error:
        raise RecordingError(f"{path}: {_what_is_wrong(path, log, names, ' '.join(str(error).split()))}") from error
    stamps, there = stamps_of(path, time, log.time.unit, table.column(time_name))
    columns = {column: numbers_of(path, column, table.column(name)) for column, name in by_column.items()}
    run = log.runs.column if log.runs else None
    rows = whole_rows(path, time, stamps, there, columns, run, lambda index: _line(path, log, index), log.time.unit)
    return replace(rows, last_line=note, last_line_dropped=cut)


class _Beginning(io.RawIOBase):
    """So many bytes of a file, as a file: of a log of gigabytes there need not be a copy without its last line."""

    def __init__(self, file: BinaryIO, size: int) -> None:
        self._file, self._left = file, size

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: Any) -> int:
        data = self._file.read(min(len(buffer), self._left))
        buffer[: len(data)] = data
        self._left -= len(data)
        return len(data)


def _until(file: BinaryIO, end: Unended | None) -> BinaryIO | io.RawIOBase:
    """The file, or what is in it before its last line."""
    return file if end is None else _Beginning(file, end.size)


def _before(log: CsvMapping) -> int:
    """Lines before the first row of data."""
    return log.preamble + int(log.header) + int(log.units_row)


def _line_number(path: Path, log: CsvMapping, index: int) -> int | None:
    """The line of a row of data, from 1. index: from 0; empty lines are no rows, those before the table are all
    counted."""
    left = index + 1
    with path.open("rb") as file:
        for number, line in enumerate(file, 1):
            if number <= _before(log):
                continue
            left -= line.strip(b"\r\n") != b""
            if left == 0:
                return number
    return None


def _line(path: Path, log: CsvMapping, index: int) -> str:
    """Where a row of data is, in words. index: from 0."""
    number = _line_number(path, log, index)
    return row_of_data(index) if number is None else f"line {number} of the file"


def _what_is_wrong(path: Path, log: CsvMapping, names: Sequence[str], what: str) -> str:
    """What pyarrow says, with the column's name and the line of the file instead of its own numbers, and what to do."""
    no_text = "can't decode" in what or "\ufffd" in what or "UTF8" in what
    if why := not_plain(path) or (not_utf8(path) if no_text else ""):
        return why
    if "Empty CSV file" in what:
        return f"nothing stands in it ({path.stat().st_size} bytes). {AGAIN}"
    column = re.match(r"In CSV column #(\d+): ", what)
    if column is not None and int(column[1]) < len(names):
        what = f"column '{names[int(column[1])]}': {what[column.end() :]}"
    number: int | None = None
    if row := re.search(r"Row #(\d+)", what):
        index = int(row[1]) - 1 - _before(log)
        number = _line_number(path, log, index) if index >= 0 else int(row[1])
        place = row_of_data(index) if number is None else f"line {number} of the file"
        what = what[: row.start()] + place + what[row.end() :]
    shown = escaped(what[:300])
    if number is not None and number > _before(log) + 1 and _cut_off(path, number, what):
        return (
            f"line {number}, the last one, is cut off, as a logger leaves it that is killed ({shown}). Leave it out: "
            f"{in_place(f'sed {number}d', path)}."
        )
    hint = _hint(path, log, what, number)
    return f"not the table that the mapping describes: {shown}.{hint} Repair the file or the mapping."


def _cut_off(path: Path, number: int, what: str) -> bool:
    """Whether this line, from 1, is the last one with anything in it and its end is missing."""
    last, whole = 0, True
    with path.open("rb") as file:
        for at, line in enumerate(file, 1):
            if line.strip(b"\r\n"):
                last, whole = at, line.endswith((b"\r", b"\n"))
    counts = re.search(r"Expected (\d+) columns, got (\d+)", what)
    if counts is not None:
        return last == number and int(counts[2]) < int(counts[1])
    return last == number and not whole


def _text_before(path: Path, log: CsvMapping, number: int) -> bool:
    """Whether everything before this line, from 1, is text: no row of numbers that could be the table's."""
    if number > MOST_TEXT:
        return False
    with path.open(encoding="utf-8", errors="replace") as file:
        lines = [line for line in itertools.islice(file, log.preamble + int(log.header), number - 1) if line.strip()]
    rows = [[cell for cell in line.split(log.delimiter) if cell.strip()] for line in lines]
    return all(any(number_of(cell, log) is None for cell in row) for row in rows)


def _other_delimiter(path: Path, log: CsvMapping) -> str:
    """What to say of a table whose first line has none of the mapping's delimiters, but as many of another one as the
    second line; empty for others."""
    try:
        with path.open(encoding="utf-8", errors="replace") as file:
            first, second = (*itertools.islice(file, log.preamble, log.preamble + 2), "", "")[:2]
    except OSError:
        return ""
    other = max(DELIMITERS, key=first.count)
    other = other if other in first else " "
    if log.delimiter in first or not 0 < first.count(other) == second.count(other):
        return ""
    shown = "\\t" if other == "\t" else other
    return f' If "{shown}" stands between columns, say delimiter: "{shown}".'


def _hint(path: Path, log: CsvMapping, what: str, number: int | None) -> str:
    """What a mapping can say about the commonest reasons. number: the line in question, from 1."""
    if other := _other_delimiter(path, log):
        return other + (' If numbers have a decimal comma, say decimal: "," too.' if log.decimal == "." else "")
    value = what.partition("invalid value '")[2].partition("'")[0]
    if "," in value and value.replace(",", "").lstrip("-+").isdecimal():
        return ' If that is a decimal comma, say decimal: "," and delimiter: ";".'
    if value and any(letter.isalpha() for letter in value) and number == _before(log) + 1 and not log.units_row:
        return " If the second line holds units, say units_row: true."
    if "Expected" in what and "columns, got" in what and number is not None and _text_before(path, log, number):
        return " If text stands before the table, say preamble: the number of its lines."
    return ""


def _column(path: Path, column: ColumnName, names: Sequence[str], log: CsvMapping) -> str:
    """The name pyarrow knows the column by."""
    if not log.header:
        if not isinstance(column, int) or not 0 <= column < len(names):
            raise RecordingError(
                f"{path}: no column {column!r}. Without a header line columns are numbers, 0 to {len(names) - 1}."
                + _other_delimiter(path, log)
            )
        return names[column]
    name = str(column)
    if list(names).count(name) > 1:
        raise RecordingError(f"{path}: two columns are named '{name}'. Rename one in the file's first line.")
    if name not in names:
        raise RecordingError(f"{path}: {no_column(name, names)}{_other_delimiter(path, log)}")
    return name
