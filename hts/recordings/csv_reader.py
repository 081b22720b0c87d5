"""Comma-separated logs, read by a mapping (mapping.py) into a recording."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

from pydantic import Field

from hts.recordings.csv_table import read_table
from hts.recordings.mapping import LogMapping
from hts.recordings.table_reader import TableReader

if TYPE_CHECKING:
    from hts.contracts import LogReader, Settings


class CsvMapping(LogMapping):
    """A mapping, and how the text is written."""

    header: bool = Field(True, description="whether the first line names the columns")
    delimiter: str = Field(",", min_length=1, max_length=1, description="between columns")
    decimal: Literal[".", ","] = Field(".", description="between a number's whole and its fraction")
    preamble: int = Field(0, ge=0, description="lines of text before the table")
    units_row: bool = Field(False, description="whether a line of units follows the names; it is skipped")


def make(settings: Settings) -> LogReader:
    """Factory of the log reader `csv`."""
    return TableReader(settings, read_table, CsvMapping)
