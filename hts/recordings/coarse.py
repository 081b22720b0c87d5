"""Whether a measured channel that keeps one number for long may be a coarse and slow gauge on a steady walk.

A monitor that averages over a second and counts in tenths of an ampere shows one number for a quarter of a minute on a
walk at a steady pace (a simulated quadruped that draws 4.6 A at 0.6 m/s: 36 s at most in 60, and 11 at 1 m/s), as one
that is no longer read does. What a log holds tells them apart: a coarse gauge's readings lie on a grid; while the robot
walks as it did, they lie within a step of that number, and mostly stand too; and it goes on: the next reading is a step
away, or comes as the robot stops, or, at the log's end, the voltage beside it still changes.

Frozen on purpose for 4 s and more at every second of these two walks, a gauge that is finer, faster, or takes what the
robot draws at the moment, never passed; one that averages passed 336 times, and the mean of the stretch was then wrong
by 1.4 of its steps at most.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hts.recordings.repeated import runs_of

STEP = (0.01, 0.1)
"""As a share of the reading: a finer gauge does not stand, and of a coarser one the steps were not seen."""
ON_GRID, NEAR = 0.1, 1.5
"""In steps: how far from the grid a reading may lie, and from the number that stands."""
SAME_PACE = 1.2
"""Times faster or slower that the joints may move, where they do as they did."""
SETTLED_SECONDS = 3.0
"""After the joints began to move: a slow gauge is still on its way."""
MOST_NEAR, MOST_STANDS = 0.9, 15.0
"""Share of the other readings at that pace that have to be near; how many times longer than they stand in the mean."""


@dataclass(frozen=True)
class Walk:
    """What is known of a log. walks: samples (T,) bool that move; pace: (T,), rad/s, of the joints; voltages: each
    (T,)."""

    walks: np.ndarray
    pace: np.ndarray
    voltages: Sequence[np.ndarray]
    rate_hz: float


def stands_by_resolution(
    values: np.ndarray, run: tuple[int, int], walk: Walk, longest: float, tolerance: float
) -> bool:
    """Whether a stretch may be one that a coarse gauge shows. values: (T,); run: its first and last sample; longest: s
    for which a number may stand anyway; tolerance: within which two values are the same."""
    first, last = run
    walks, edge = walk.walks, round(longest * walk.rate_hz)
    held, runs = values[first], runs_of(np.abs(np.diff(values)) <= tolerance)
    step = _step(np.array([values[begin] for begin, _ in runs]), tolerance)
    if step is None or not STEP[0] <= step / abs(held) <= STEP[1]:
        return False
    if (~walks[first : last + 1]).sum() > edge:  # standing takes another number
        return False
    number, settled = np.arange(len(values)), _settled(walks, walk.rate_hz)
    inside = (number >= first) & (number <= last)
    pace = walk.pace[inside & settled]
    usual = float(np.median(pace)) if len(pace) else 0.0
    if not len(pace) or np.quantile(pace, 0.95) > SAME_PACE * usual or np.quantile(pace, 0.05) < usual / SAME_PACE:
        return False
    alike = settled & ~inside & (walk.pace < SAME_PACE * usual) & (walk.pace > usual / SAME_PACE)
    if alike.any():
        near = np.abs(values[alike] - held) <= NEAR * step
        if near.mean() < MOST_NEAR or last - first > MOST_STANDS * _mean_stand(values, alike, tolerance):
            return False
    known = alike.sum() >= edge
    earlier, later = [one for one in runs if one[1] < first], [one for one in runs if one[0] > last]
    if not known and not (earlier and walks[first]):  # nothing says what it should show, nor that it came to this
        return False
    began = not walks[max(0, first - edge) : first + 1].all()
    if earlier and not began and abs(values[earlier[-1][0]] - held) > NEAR * step:
        return False
    if later:
        return not walks[last : last + edge + 1].all() or abs(values[later[0][0]] - held) <= NEAR * step
    return bool(known) and any(_goes_on(one[first : last + 1], edge) for one in walk.voltages)


def _step(levels: np.ndarray, tolerance: float) -> float | None:
    """The step of the grid on which all levels lie; None where they lie on none."""
    different = np.unique(levels)
    apart = np.diff(different)
    apart = apart[apart > 2 * tolerance]
    if not len(apart):
        return None
    step = float(apart.min())
    steps = (different - different[0]) / step
    return step if np.abs(steps - np.round(steps)).max() <= ON_GRID else None


def _settled(walks: np.ndarray, rate_hz: float) -> np.ndarray:
    """Samples (T,) bool at which the joints have moved for SETTLED_SECONDS."""
    number = np.arange(len(walks))
    stood = np.maximum.accumulate(np.where(walks, -1, number))
    return np.asarray(number - stood > SETTLED_SECONDS * rate_hz)


def _mean_stand(values: np.ndarray, where: np.ndarray, tolerance: float) -> float:
    """For how many samples one number stands in the mean where it stands at all. where: samples (T,) bool."""
    stands = runs_of((np.abs(np.diff(values)) <= tolerance) & where[1:])
    return float(np.mean([last - first for first, last in stands])) if stands else 0.0


def _goes_on(values: np.ndarray, samples: int) -> bool:
    """Whether it never keeps one number for more than so many samples and more than a quarter of them all. values:
    (T,)."""
    stands = runs_of(np.diff(values) == 0)
    return all(last - first <= max(samples, len(values) / 4) for first, last in stands)
