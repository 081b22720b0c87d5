"""A log reader of files that are tables: which columns are which channel is in the mapping, the rest is logs.py."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic

from hts.config import Config
from hts.contracts import LogReader, Robot
from hts.recordings.logs import recording_from_tables, recordings_from_tables
from hts.recordings.mapping import Mapped, parse_mapping
from hts.recordings.recording import Recording
from hts.recordings.table import ColumnName, Table

if TYPE_CHECKING:
    from hts.contracts import Settings


class NoSettings(Config):
    """The reader has no settings; everything is in the mapping."""


class TableReader(LogReader, Generic[Mapped]):
    """Columns to channels, resampled to one even rate, short gaps filled, checked against the robot.

    settings: of the reader, which has none. read_table: a file, the wanted columns and the mapping -> Table.
    mapping: the class that a mapping for this reader is parsed into.
    """

    def __init__(
        self,
        settings: Settings,
        read_table: Callable[[Path, Sequence[ColumnName], Mapped], Table],
        mapping: type[Mapped],
    ) -> None:
        NoSettings.model_validate(dict(settings))
        self._read_table, self._mapping = read_table, mapping

    def read(self, files: Sequence[Path], mapping: Mapping[str, Any], robot: Robot) -> Recording:
        """One recording from one file or folder, or from several that the mapping's `files` tells apart.

        Raises ConfigError for a wrong mapping, RecordingError naming file, column and what to do for a wrong log.
        """
        return recording_from_tables(files, parse_mapping(mapping, self._mapping), robot, self._read_table)

    def read_all(self, files: Sequence[Path], mapping: Mapping[str, Any], robot: Robot) -> Sequence[Recording]:
        """The same for every run that the mapping's `runs` or `labels` tell apart."""
        return recordings_from_tables(files, parse_mapping(mapping, self._mapping), robot, self._read_table)
