"""Where on its schedule a recording is: its sample at a moment, and which command held at each of its samples.

A schedule begins with the recording's first sample, whatever its clock says then. Clocks jitter, and differences of
their stamps are rounded, so a moment is compared halfway between samples: one that is due at 80 s and is stamped
79.9999 s after the first is that of 80 s.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from hts.recordings.recording import Recording


NOT_STATED = "not stated in the mapping"
"""Note `schedule` of a recording whose log came without its commands: one of standing is made up for it."""


def stated(notes: Mapping[str, str]) -> bool:
    """Whether somebody said what was commanded in the recording with these notes; its schedule means nothing else."""
    return notes.get("schedule") != NOT_STATED


def samples_at(recording: Recording, moments: Sequence[float] | np.ndarray) -> np.ndarray:
    """Index of the first sample at or after each moment, (M,); T, the number of samples, where there is none.

    moments: s after the first sample, (M,), in any order.
    """
    elapsed = recording.time - recording.time[0]
    return np.searchsorted(elapsed, np.asarray(moments, dtype=np.float64) - 0.5 / recording.rate_hz)


def command_at(recording: Recording) -> np.ndarray:
    """Which command of the schedule held at each sample, as its index in `schedule.commands`, (T,); the last one lasts
    until the recording ends."""
    ends = np.cumsum([command.seconds for command in recording.schedule.commands])
    return np.searchsorted(samples_at(recording, ends[:-1]), np.arange(recording.num_samples), side="right")
