"""Comma-separated logs, read by a mapping (mapping.py) into a recording."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from pydantic import Field

from hts.config import Config
from hts.contracts import LogReader, Robot
from hts.recordings.csv_table import read_table
from hts.recordings.logs import recording_from_tables, recordings_from_tables
from hts.recordings.mapping import LogMapping, parse_mapping
from hts.recordings.recording import Recording

if TYPE_CHECKING:
    from hts.contracts import Settings


class CsvSettings(Config):
    """The reader has no settings; everything is in the mapping."""


class CsvMapping(LogMapping):
    """A mapping, and how the text is written."""

    header: bool = Field(True, description="whether the first line names the columns")
    delimiter: str = Field(",", min_length=1, max_length=1, description="between columns")
    decimal: Literal[".", ","] = Field(".", description="between a number's whole and its fraction")
    preamble: int = Field(0, ge=0, description="lines of text before the table")
    units_row: bool = Field(False, description="whether a line of units follows the names; it is skipped")


def make(settings: Settings) -> LogReader:
    """Factory of the log reader `csv`."""
    CsvSettings.model_validate(dict(settings))
    return CsvReader()


class CsvReader(LogReader):
    """Columns to channels, resampled to one even rate, short gaps filled, checked against the robot."""

    def read(self, files: Sequence[Path], mapping: Mapping[str, Any], robot: Robot) -> Recording:
        """One recording from one file, or from several that the mapping's `files` tells apart.

        Raises ConfigError for a wrong mapping, RecordingError naming file, column and what to do for a wrong log.
        """
        return recording_from_tables(files, parse_mapping(mapping, CsvMapping), robot, read_table)

    def read_all(self, files: Sequence[Path], mapping: Mapping[str, Any], robot: Robot) -> Sequence[Recording]:
        """The same for every run that the mapping's `runs` or `labels` tell apart."""
        return recordings_from_tables(files, parse_mapping(mapping, CsvMapping), robot, read_table)
