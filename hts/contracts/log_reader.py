"""A log reader: somebody's log files, turned into a recording."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from hts.contracts.robot import Robot
    from hts.recordings.recording import Recording


class LogReader(ABC):
    """Turns somebody's log files into a recording."""

    @abstractmethod
    def read(self, files: Sequence[Path], mapping: Mapping[str, Any], robot: Robot) -> Recording:
        """One recording from the files. Raises RecordingError naming file, column and what to do."""

    def read_all(self, files: Sequence[Path], mapping: Mapping[str, Any], robot: Robot) -> Sequence[Recording]:
        """Every run in the files, one recording each, where a mapping tells several apart; by default `read`'s one."""
        return [self.read(files, mapping, robot)]
