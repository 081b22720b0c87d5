"""The last line of a comma-separated log, where its end is missing: a logger that is killed stops in the midst of one.

A line with a line feed is whole, and what is wrong with it is refused like anywhere. One without is either cut, or the
last line of a writer that puts line feeds between lines only, so it is kept wherever it may be whole. It is left out,
which is noted with its number, where it shows that it is not:

- it has fewer cells than there are columns;
- its last cell is no number, such as "-" or "1e" (of -3.2 or 1e-05);
- its last cell has fewer decimals than every other row has there, as "0.12" where all others look like "0.1234":
  writers of one format print one number of them, so where it has as many it is whole;
- its last cell is the time, and does not come after the row before, as 12.3 after 12.32.

What is left are last cells of varying length, such as 0.12 of 0.1234 among 0.5 and 1.25. Whether that number is whole
nobody can tell, since writers print short numbers too, and leaving the row out would take a whole one from every log
without a last line feed. It is kept, and a note says so where its column is one of those read.
"""

from __future__ import annotations

import csv
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from hts.recordings.encoding import escaped

if TYPE_CHECKING:
    from hts.recordings.csv_reader import CsvMapping

BLOCK = 1 << 16
LOOKED_AT = 200
"""Lines before the last one whose decimals are compared."""
SHOWN = 60


@dataclass(frozen=True)
class Unended:
    """A last line without a line feed. number: from 1; size: bytes of the file before it; text: of it; rows: lines
    before it."""

    number: int
    size: int
    text: str
    rows: list[str]


def unended_line(path: Path, before: int) -> Unended | None:
    """The last line of the file, if it has no line feed and is not the only row of data. before: lines before those."""
    with path.open("rb") as file:
        size = file.seek(0, 2)
        file.seek(max(size - BLOCK, 0))
        tail = file.read()
        if not tail or tail[-1:] in b"\r\n" or b"\n" not in tail:  # longer lines are no log's
            return None
        file.seek(0)
        number = sum(1 for _ in file)
    lines = tail.split(b"\n")
    if number <= before + 1 or not lines[-1].strip():
        return None
    rows = [line.decode("utf-8", "replace").strip("\r") for line in lines[1 if size > BLOCK else 0 : -1][-LOOKED_AT:]]
    return Unended(number, size - len(lines[-1]), lines[-1].decode("utf-8", "replace"), [row for row in rows if row])


def of_last_line(
    line: Unended, log: CsvMapping, names: Sequence[str], wanted: Collection[str], missing: Collection[str]
) -> tuple[str, bool]:
    """What to note of it, "" for nothing, and whether it is left out.

    names: of the columns; wanted: those that are read; missing: what stands for a number that is not there.
    """
    cells = _cells(line.text, log)
    shown = escaped(line.text[:SHOWN] + ("…" if len(line.text) > SHOWN else ""))
    cut = (f"line {line.number}, the last one, cut off as by a logger that is killed ('{shown}')", True)
    if len(cells) < len(names):
        return cut
    if len(cells) > len(names) or names[-1] not in wanted or cells[-1].strip() in missing:
        return "", False
    whole = [one for one in (_cells(row, log) for row in line.rows) if len(one) == len(names)]
    others = [one[-1] for one in whole if one[-1].strip() not in missing]
    numbers = [number_of(one, log) for one in others]
    last = number_of(cells[-1], log)
    if last is None:  # among dates, or other words, it is what the mapping says that is wrong
        return cut if numbers and None not in numbers else ("", False)
    is_time = names[-1] == (str(log.time.column) if log.header else names[int(log.time.column)])
    early = is_time and bool(numbers) and numbers[-1] is not None and last <= numbers[-1]
    decimals = {_decimals(one, log) for one in others} or {0}
    if early or _decimals(cells[-1], log) < min(decimals):
        return cut
    if len(decimals) == 1 and min(decimals) > 0:
        return "", False
    return (
        f"line {line.number} has no line feed: nobody can tell whether its last number, {cells[-1]:.20}, is whole",
        False,
    )


def _cells(line: str, log: CsvMapping) -> list[str]:
    return next(csv.reader([line], delimiter=log.delimiter), [])


def number_of(cell: str, log: CsvMapping) -> float | None:
    """The number in a cell; None where there is none."""
    try:
        return float(cell.strip().replace(log.decimal, "."))
    except ValueError:
        return None


def _decimals(cell: str, log: CsvMapping) -> int:
    """Digits after the decimal point; of one with an exponent 0, whose length says nothing."""
    if "e" in cell.lower():
        return 0
    return len(cell.strip().partition(log.decimal)[2])
