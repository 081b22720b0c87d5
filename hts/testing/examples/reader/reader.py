"""The log reader `jsonl`: from somebody's files to columns; the mapping says which column is which channel.

As it stands: one JSON object a line, such as {"t": 20, "tau_left": 0.1, "current": 1.9}. Replace `columns_of`.
"""

from __future__ import annotations

import json

from hts.config import Config
from hts.contracts import LogReader
from hts.recordings.logs import recording_from_columns


class Settings(Config):
    """A reader is told everything by the mapping, so there are none."""


class Jsonl(LogReader):
    """Units, signs, joint order, gaps, limits, idle levels: all as in the mapping of any other reader."""

    def read(self, files, mapping, robot):
        return recording_from_columns(files, mapping, robot, columns_of)


def columns_of(file):
    """All columns of one file, name -> one number a row; None where a row has none."""
    rows = [json.loads(line) for line in file.read_text(encoding="utf-8").splitlines()]
    return {name: [row.get(name) for row in rows] for name in rows[0]}
