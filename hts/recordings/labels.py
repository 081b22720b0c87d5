"""A file of labels: one stretch of time a line, with a word for what was done in it."""

from __future__ import annotations

import csv
import math
from pathlib import Path
from typing import NamedTuple

from hts.errors import RecordingError, unknown_name
from hts.recordings.mapping_parts import LabelsMapping
from hts.recordings.table import cannot_be_read

MOST_BYTES = 1 << 20


class Label(NamedTuple):
    """A word for the stretch from `start` to `end`, s after the log's first stamp."""

    start: float
    end: float
    word: str


def read_labels(path: Path, labels: LabelsMapping) -> list[Label]:
    """The labels of a comma-separated file with a header line, in order; empty lines are left out.

    Raises RecordingError naming file and line: another column, no number, an end before its beginning, no label.
    """
    try:
        if path.stat().st_size > MOST_BYTES:
            raise RecordingError(f"{path}: {path.stat().st_size} bytes of labels, expected at most {MOST_BYTES}.")
        text = path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise cannot_be_read(path, error) from error
    except UnicodeDecodeError as error:
        raise RecordingError(f"{path}: labels that are no text ({error.reason}). Write them as UTF-8.") from error
    rows = csv.DictReader(text.splitlines())
    try:
        names = rows.fieldnames or ()
        for column in (labels.start, labels.end, labels.label):
            if column not in names:
                raise RecordingError(f"{path}: " + unknown_name("column", column, names))
        filled = (row for row in rows if any(isinstance(cell, str) and cell.strip() for cell in row.values()))
        found = [_label(f"{path}: line {rows.line_num}", row, labels) for row in filled]
    except csv.Error as error:
        raise RecordingError(f"{path}: not a table of labels ({error}). Repair the file.") from error
    if not found:
        raise RecordingError(f"{path}: no labels. Write one stretch a line, or leave `labels` out of the mapping.")
    return sorted(found)


def _label(where: str, row: dict[str, str], labels: LabelsMapping) -> Label:
    try:
        start, end = float(row[labels.start]), float(row[labels.end])
    except (TypeError, ValueError) as error:
        raise RecordingError(f"{where}: beginning and end are no numbers of seconds ({error}). Repair it.") from error
    if not (math.isfinite(start) and math.isfinite(end) and start < end):
        raise RecordingError(f"{where}: from {start:g} to {end:g} s; its end must come after its beginning.")
    word = (row[labels.label] or "").strip()
    if not word:
        raise RecordingError(f"{where}: no word in '{labels.label}'. Name what was done, or remove the line.")
    return Label(start, end, word)
