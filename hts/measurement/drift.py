"""Whether a target remembers minutes: how much of what it does while the command stays the same is a steady drift.

Who walks at one commanded speed does the same stride after stride, and what forgets within about a second shows the
same second after second. A temperature still rises: a model with a memory then tells the time since a recording
began, which explains others that began as cold and no warm ones.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from hts.measurement.scoring import one_a_sample, varies
from hts.recordings.on_schedule import command_at, stated

if TYPE_CHECKING:
    from hts.recordings.recording import Recording

CHANGING_SECONDS = 2.0
"""After each change of the command: the walk itself is then changing."""
LEAST_SECONDS = 3.0
"""Of the rest of a stretch, that a drift is seen in."""
LEAST_SAMPLES = 8
"""Of it, where a log is slow: both halves have a line."""
MOSTLY = 0.5
"""Share of a stretch's changes from which on they are a drift."""
NOTICED = 0.001
"""Share of all that a target changes by, below which a drift is not worth a line: a warming gear, a falling charge."""


@dataclass(frozen=True)
class Drift:
    """within: share of the target's variance inside stretches of one command that straight lines in time explain, where
    it drifts: in both halves the same way, and so that a line explains most of each, as a step, a stop and a level that
    wanders do not; of_all: the same as a share of its variance over all recordings."""

    within: float
    of_all: float

    @property
    def remembers(self) -> bool:
        """Whether the target mostly drifts where it should stand."""
        return self.within > MOSTLY and self.of_all > NOTICED


def drift(recordings: Sequence[Recording], target: str) -> Drift | None:
    """Of a channel of one number in these recordings; None where no stretch is long enough, or nothing varies. Samples
    that are no number are left out, and recordings whose commands nobody stated."""
    lines, changes = 0.0, 0.0
    for values in _stretches(recordings, target):
        (whole, all_of_it), middle = _line(values), len(values) // 2
        halves = [_line(values[:middle]), _line(values[middle:])]
        steady = all(line * whole > 0 and line**2 > MOSTLY * change for line, change in halves)
        lines += whole**2 if steady else 0.0
        changes += all_of_it
    everything = np.concatenate([one_a_sample(one, target) for one in recordings]) if recordings else np.empty(0)
    everything = everything[np.isfinite(everything)]
    total = float(((everything - everything.mean()) ** 2).sum()) if len(everything) else 0.0
    square = float((everything**2).sum())
    return Drift(lines / changes, lines / total) if varies(changes, square) and varies(total, square) else None


def drift_note(target: str, found: Drift | None) -> str:
    """Half a sentence for a person; "" where nothing is to be said."""
    if found is None or not found.remembers:
        return ""
    return (
        f"while the command stays the same, {found.within:.0%} of what '{target}' changes by is a steady drift, so it "
        "remembers more than about a second, as a temperature does"
    )


REMEDY = "make a target of the loss that heats instead (docs/measurement.md)"
"""What to do about one that remembers."""


def _line(values: np.ndarray) -> tuple[float, float]:
    """Slope of the straight line through samples that follow each other, in units whose square is what it explains of
    the sum of squares about their mean, which is the other number."""
    time = np.arange(len(values)) - (len(values) - 1) / 2
    values = values - values.mean()
    return float(time @ values) / float(np.sqrt(time @ time)), float(values @ values)


def _stretches(recordings: Sequence[Recording], target: str) -> Iterator[np.ndarray]:
    """The target in each steady stretch of one command."""
    for one in recordings:
        if not stated(one.notes):
            continue
        at, values = command_at(one), one_a_sample(one, target)
        skip = round(CHANGING_SECONDS * one.rate_hz)
        for command in np.unique(at):
            part = values[at == command][skip:]
            part = part[np.isfinite(part)]
            if len(part) >= max(LEAST_SAMPLES, LEAST_SECONDS * one.rate_hz):
                yield part
