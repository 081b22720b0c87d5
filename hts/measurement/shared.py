"""Samples that are held out and yet among those that are fitted to: taken out, or the score would mean nothing.

It happens where the file of one move was cut from the log of the whole run, or the same log lies in two stores. Stores
at other rates, or resampled at other instants, have no samples in common that could be found so.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from hts.measurement.split import named_part
from hts.recordings.header import array_digest
from hts.recordings.repeated import runs_of

if TYPE_CHECKING:
    from hts.recordings.recording import Recording

WINDOW = 5  # samples in a row that must be the same: one alone may be, at rest
DISTINCT = 3  # of them; a robot that stands still says the same thing again and again
FINENESS = 1e-3  # of a channel's standard deviation: resampling may change the last digits
MARGIN_SECONDS = 0.5  # on each side is cut too: neighbours know each other
LEAST_SECONDS = 1.0  # a part that is left and shorter is dropped


@dataclass(frozen=True)
class Shared:
    """held_out: samples of the held-out recordings that are in the training too, of `of`; removed: samples that left
    the training for it."""

    held_out: int
    of: int
    removed: int = 0


def shared_samples(
    training: Sequence[Recording], held_out: Sequence[Recording], channels: Sequence[str]
) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Which samples are in both, bool (T,) for each recording of either: the same values of all channels at some
    instants in a row."""
    everything = [*training, *held_out]
    if not training or not held_out:
        return [np.zeros(one.num_samples, bool) for one in training], [
            np.zeros(one.num_samples, bool) for one in held_out
        ]
    tables = [
        np.concatenate([one.values(name).reshape(one.num_samples, -1) for name in channels], 1).astype(np.float64)
        for one in everything
    ]
    joined = np.concatenate(tables)
    step = FINENESS * joined.std(0)
    step[step == 0] = 1.0
    rows = np.ascontiguousarray(np.round(joined / step).astype(np.int64))
    _, number = np.unique(rows.view(np.dtype((np.void, rows.shape[1] * 8))).ravel(), return_inverse=True)
    numbers = np.split(number, np.cumsum([len(table) for table in tables])[:-1])
    split = len(training)
    left, right = (
        {window.tobytes() for one in part for _, window in _varied(one)} for part in (numbers[:split], numbers[split:])
    )
    both = left & right
    marked = [_marked(one, both) for one in numbers]
    return marked[:split], marked[split:]


def copies(recordings: Sequence[Recording], channels: Sequence[str]) -> list[tuple[Recording, Recording]]:
    """(the first, the other) of recordings that hold the very same samples of these channels: one walk that is there
    twice. Nothing is said of what stands still."""
    first: dict[tuple[str, ...], Recording] = {}
    found = []
    for one in recordings:
        values = [one.values(name) for name in channels]
        if all(np.ptp(each) == 0 for each in values):
            continue
        before = first.setdefault(tuple(array_digest(each) for each in values), one)
        if before is not one:
            found.append((before, one))
    return found


def told_of_copies(recordings: Sequence[Recording], channels: Sequence[str]) -> list[str]:
    """One line for each of them."""
    return [
        f"recordings {first.id} ({first.notes.get('source', 'no source')}) and {other.id} "
        f"({other.notes.get('source', 'no source')}) hold the same samples, so one walk counts twice: delete the "
        "folder of the one that is wrong from the store"
        for first, other in copies(recordings, channels)
    ]


def without_shared(
    training: Sequence[Recording], held_out: Sequence[Recording], channels: Sequence[str]
) -> tuple[list[Recording], Shared]:
    """The training without what is held out too, and without half a second on each side of it."""
    in_training, in_held = shared_samples(training, held_out, channels)
    found = Shared(int(sum(one.sum() for one in in_held)), sum(one.num_samples for one in held_out))
    if not found.held_out:
        return list(training), found
    kept: list[Recording] = []
    for recording, marked in zip(training, in_training, strict=True):
        margin = round(MARGIN_SECONDS * recording.rate_hz)
        wide = np.convolve(marked, np.ones(2 * margin + 1), "same") > 0.5 if marked.any() else marked
        kept += [
            named_part(recording, a, b)
            for a, b in runs_of(~wide)
            if not wide.any() or b - a >= LEAST_SECONDS * recording.rate_hz
        ]
    removed = sum(one.num_samples for one in training) - sum(one.num_samples for one in kept)
    return kept, Shared(found.held_out, found.of, removed)


def _marked(numbers: np.ndarray, both: set[bytes]) -> np.ndarray:
    marked = np.zeros(len(numbers), bool)
    if both:
        for start, window in _varied(numbers):
            if window.tobytes() in both:
                marked[start : start + WINDOW] = True
    return marked


def _varied(numbers: np.ndarray) -> list[tuple[int, np.ndarray]]:
    """Windows in which something changes, with where they begin."""
    if len(numbers) < WINDOW:
        return []
    windows = np.lib.stride_tricks.sliding_window_view(numbers, WINDOW)
    ordered = np.sort(windows, axis=1)
    distinct = 1 + (np.diff(ordered, axis=1) != 0).sum(1)
    return [(int(start), windows[start]) for start in np.flatnonzero(distinct >= DISTINCT)]
