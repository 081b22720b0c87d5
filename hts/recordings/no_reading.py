"""Numbers that a logger writes where it had no reading: 0, -1, 9999, 65535 among others that are right.

Costs are means of what only the robot measures, so a current that is 0 in every third sample looks like a policy that
saves a third, and 9 samples of 9999 A rule all others. Neither the median nor the limits of joints show it.

What is written for want of a reading is one number to the last digit, comes and goes within a sample, and lies where
the others never are. A drive that gives back energy for a moment, or a gauge that clips at 0, scatters, stays longer or
gets there by degrees; where it does not, `limits` says so.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping

import numpy as np

from hts.errors import RecordingError
from hts.recordings.recording import Series
from hts.recordings.repeated import runs_of

FAR, NEAR = 10.0, 6.0
"""In standard deviations of the bulk, by the median absolute deviation: so far from the median is such a number, and so
near to it are the samples before and after."""
LEAST_SHARE, LEAST_RUNS = 0.01, 3
"""Of the samples, and how often it comes; less moves no mean by much."""
LEAST_SAMPLES, LONGER = 10, 3
"""In a row, and times as many as other numbers: then once is enough."""
FINENESS = 1e-5
"""Of the spread, or of the largest sample: resampling changes the last digits of a number that is one."""
ABSURD = 100.0
"""Times what 95 % of the samples do not exceed: no sensor has such a range, and one sample would rule a mean."""


def check_no_reading(
    channels: Mapping[str, Series], measured: Collection[str], where: str, stated: Collection[str] = ()
) -> None:
    """Raise RecordingError for a measured channel in which a number stands for readings that were not there.

    measured: names of what only the robot gives; where: begins the message; stated: names of channels whose limits a
    mapping states, which is a person's word for them.
    """
    for name in measured:
        if name in stated:
            continue
        series = channels[name]
        for column in series.values.reshape(len(series.values), -1).astype(np.float64).T:
            if found := _filler(column) or _absurd(column):
                unit = series.channel.unit
                others = column[np.abs(column - found[0]) > FINENESS * np.abs(column).max()]
                low, high = np.quantile(others, [0.05, 0.95])
                raise RecordingError(
                    f"{where}: '{name}' is {found[0]:g} {unit} in {found[1]} of {len(column)} samples, between others "
                    f"of {low:.4g} to {high:.4g} {unit}: the logger probably wrote that where it had no reading. "
                    "Leave those cells empty, or record again; a few are left out by `limits` and `outside: drop`, and "
                    "if they are right, `limits` alone says so."
                )


def _filler(column: np.ndarray) -> tuple[float, int] | None:
    """A number on the other side of 0, or 0, that comes and goes within a sample, and how many samples hold it."""
    middle = float(np.median(column))
    spread = 1.4826 * float(np.median(np.abs(column - middle)))
    if middle == 0 or spread == 0:
        return None
    as_it_is, column = column, FINENESS * spread * np.round(column / (FINENESS * spread))
    far = column[(np.abs(column - middle) > FAR * spread) & (column * middle <= 0)]
    values, counts = np.unique(far, return_counts=True)
    for value, count in zip(values, counts, strict=True):
        runs = runs_of(column == value)
        around = [column[at] for first, end in runs for at in (first - 1, end) if 0 <= at < len(column)]
        comes_and_goes = np.mean(np.abs(np.array(around) - middle) < NEAR * spread) > 0.9
        if count >= LEAST_SHARE * len(column) and comes_and_goes and (len(runs) >= LEAST_RUNS or _stays(column, runs)):
            return 0.0 if value == 0 else float(np.median(as_it_is[column == value])), int(count)
    return None


def _stays(column: np.ndarray, runs: list[tuple[int, int]]) -> bool:
    """Whether a number stays much longer than others do: 0, at which a gauge may clip, than any other, a number on the
    other side of 0 than most."""
    longest, value = max(end - first for first, end in runs), column[runs[0][0]]
    same = np.diff(column) == 0
    for first, end in runs:
        same[first : end - 1] = False
    others = [1 + last - first for first, last in runs_of(same)] or [1]
    usual = max(others) if value == 0 else float(np.median(others))
    return bool(longest >= max(LEAST_SAMPLES, LONGER * usual))


def _absurd(column: np.ndarray) -> tuple[float, int] | None:
    """The number farthest beyond all others, and how many samples lie so far out."""
    size = np.abs(column)
    usual = float(np.quantile(size, 0.95))
    wrong = size > ABSURD * usual
    if usual == 0 or not wrong.any():
        return None
    return float(column[np.argmax(size)]), int(wrong.sum())
