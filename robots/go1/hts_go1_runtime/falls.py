"""A fall is an answer: what was walked until then is kept as the row's log, which says so.

A robot that tips over is stopped long before it lies, and would leave half a log that nobody reads: a policy that falls
now and then would seem never to fall, and one that always falls would be walked for ever.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from typing import Any

from hts_go1_runtime.errors import Stopped
from hts_go1_runtime.log import RowLog
from hts_go1_runtime.rows import Row

WHILE_TRIMMED = "fell_while_trimmed"
"""The note of a log that holds the trimming in which the robot fell, in place of the row that was to follow."""
LEAST = 2  # steps: fewer are no log

Step = tuple[float, Mapping[str, Any], Sequence[float]]


class Walked:
    """Steps in memory, as a `RowLog` takes them; the last `most` of them."""

    def __init__(self, most: int) -> None:
        self._steps: deque[Step] = deque(maxlen=most)

    def write(self, clock: float, values: Mapping[str, Any], noted: Sequence[float]) -> None:
        """One step, as `RowLog.write`."""
        self._steps.append((clock, values, noted))

    def __len__(self) -> int:
        return len(self._steps)

    def into(self, log: RowLog) -> None:
        """Write all of them."""
        for step in self._steps:
            log.write(*step)


def fell(why: BaseException, row: Row, steps: int) -> bool:
    """Whether a row that ended early is kept as a fall: the trunk tipped over in a head-to-head. Other stops may be of
    anything, and data for learning are recorded again."""
    return isinstance(why, Stopped) and why.reason == "tilt" and row.role != "collection" and steps >= LEAST
