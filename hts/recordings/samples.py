"""What a log holds of one channel, and how it comes to an even rate."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from hts.errors import RecordingError
from hts.recordings.resample import hold, interpolate, window_mean

# A log that is this much faster than wanted is one whose stamps were read in the wrong unit.
TOO_FAST = 500.0
# And so many times slower: units differ by 1000, and a log may be twenty times faster than what is wanted of it.
TOO_SLOW = 50.0
# A step longer than so many sample periods is a gap.
GAP = 1.5
# Eleven days at 50 Hz: nobody records that, but a clock that jumps does.
MOST_SAMPLES = 50_000_000
# So many of its own periods the last reading of a slow gauge stands for what came after it.
OLDEST = 3.0
# s: and no longer, unless somebody says so. Seconds read in another unit look like a gauge that is read once a minute.
OLDEST_SECONDS = 3.0
# Of a channel's samples so many may be straight lines across gaps: a log that loses a row in four has fewer.
MOST_DRAWN = 1 / 3
SLACK = 1e-6
"""Sample periods by which an instant may miss a stamp and still be at it."""


@dataclass(frozen=True, eq=False)
class Samples:
    """What a log holds of one channel, rows that hold no whole sample left out.

    times: (rows,) s, increasing; values: (rows, k), as in the log; where: begins every message, such as the file;
    columns: where in it the channel is, for messages; left_out: times of the rows that were, s;
    holes: name of each component's column -> times of the rows in which it has no number, (h,) s, for messages;
    oldest: how long a reading is held, s; None where none is. Made by `samples_of`, which checks them, and by `held`.
    """

    name: str
    times: np.ndarray
    values: np.ndarray
    where: str
    columns: str = ""
    left_out: np.ndarray = field(default_factory=lambda: np.empty(0))
    holes: Mapping[str, np.ndarray] = field(default_factory=dict)
    oldest: float | None = None

    @property
    def rate_hz(self) -> float:
        """Of the log: one over the median step."""
        return 1.0 / float(np.median(np.diff(self.times)))

    @property
    def end(self) -> float:
        """Until when it has data, s: a reading that is held stands until the next one is due."""
        return float(self.times[-1]) + (0.0 if self.oldest is None else 1.0 / self.rate_hz)

    def empty_between(self, start: float, end: float) -> str:
        """In words, the columns that lack numbers between two times, s; empty where whole rows are missing."""
        return listed([name for name, when in self.holes.items() if ((when > start) & (when < end)).any()])


def listed(names: Sequence[str], most: int = 3) -> str:
    """The first names, and a sign that there are more."""
    return ", ".join(names[:most]) + (", …" if len(names) > most else "")


def samples_of(
    name: str, times: np.ndarray, values: np.ndarray, where: str, columns: str = "", components: Sequence[str] = ()
) -> Samples:
    """The samples of channel `name`: times (rows,) s, values (rows,) or (rows, k), NaN where the log has nothing.

    where: begins every message; columns: where in the log the channel is, for messages; components: what the column of
    each component is called, k of them, so that messages can name those that lack numbers.
    Raises RecordingError for times that do not increase, other lengths, infinite values, less than two samples.
    """
    times, values = np.asarray(times, dtype=np.float64), np.asarray(values, dtype=np.float64)
    values = values.reshape(len(values), -1) if values.size else values.reshape(len(values), 1)
    if times.shape != (len(values),):
        raise RecordingError(f"{where}: '{name}' has {len(values)} rows for times of shape {times.shape}.")
    if np.isinf(values).any() or not np.isfinite(times).all():
        raise RecordingError(f"{where}: '{name}' has infinite values or no times. Repair the log or cut it there.")
    back = np.flatnonzero(~(np.diff(times) > 0))
    if len(back):
        raise RecordingError(
            f"{where}: time does not increase at row {back[0] + 2} of '{name}': {times[back[0]]:.6f} s, then "
            f"{times[back[0] + 1]:.6f} s. Sort or repair the log."
        )
    there = np.isfinite(values).all(axis=1)
    if there.sum() < 2:
        named = components if len(components) == values.shape[1] else ()
        empty = [one for one, column in zip(named, values.T, strict=False) if np.isfinite(column).sum() < 2]
        said = listed(empty) or columns
        raise RecordingError(
            f"{where}: columns of '{name}'{f' ({said})' if said else ''} hold no numbers. "
            f"Correct the mapping, or leave '{name}' out of it (hts import: --drop {name})."
        )
    holes = {}
    if len(components) == values.shape[1]:
        missing = ((one, times[~np.isfinite(column)]) for one, column in zip(components, values.T, strict=True))
        holes = {one: when for one, when in missing if len(when)}
    return Samples(name, times[there], values[there], where, columns, times[~there], holes)


def held(samples: Samples, max_gap_seconds: float = 0.1, max_age_seconds: float | None = None) -> Samples:
    """The same samples as readings that each stand until the next: for `resampled(…, "hold")`, and a `common_grid` that
    such a gauge may be slower than.

    max_age_seconds: how old a reading may become; left out: three median steps of the samples, at most 3 s, or
    `max_gap_seconds` if that is longer.
    """
    usual = min(OLDEST / samples.rate_hz, OLDEST_SECONDS)
    longest = max(usual, max_gap_seconds) if max_age_seconds is None else max_age_seconds
    return replace(samples, oldest=longest)


def common_grid(
    samples: Mapping[str, Samples],
    rate_hz: float,
    max_gap_seconds: float = 0.1,
    *,
    gauges: Collection[str] = (),
    control_rate_hz: float | None = None,
) -> np.ndarray:
    """Even sample times, s, over the stretch where every channel has data.

    gauges: names of channels that only the real robot has, and control_rate_hz: of the robot's policy, Hz; both for
    what messages advise. Raises RecordingError for channels that share no stretch, a gap longer than `max_gap_seconds`
    (of those that are `held`: longer than a reading is), more than a third of the samples in shorter gaps, a log slower
    than `rate_hz` (samples cannot be invented) or so much faster that the unit of its stamps must be wrong.
    """
    start = max(one.times[0] for one in samples.values())
    end = min(one.end for one in samples.values())
    for name, one in samples.items():
        rate = one.rate_hz
        if rate < 0.9 * rate_hz and one.oldest is None:
            found = f"'{name}' was logged at {rate:.4g} Hz, the mapping wants {rate_hz:g}"
            what_to_do = _slow(name, rate, name in gauges, control_rate_hz)
            if TOO_SLOW * rate < rate_hz:
                raise RecordingError(
                    f"{one.where}: by its stamps {found}. The unit of the stamps is probably another (time.unit); if "
                    f"not, {what_to_do}: samples cannot be invented."
                )
            raise RecordingError(
                f"{one.where}: {found}. {what_to_do[:1].upper()}{what_to_do[1:]}; samples cannot be invented. If the "
                "log is faster than that, correct time.unit."
            )
        if rate > TOO_FAST * rate_hz:
            raise RecordingError(
                f"{one.where}: by its stamps '{name}' was logged at {rate:.4g} Hz and lasts "
                f"{one.times[-1] - one.times[0]:.4g} s, the mapping wants {rate_hz:g} Hz. The unit of the stamps is "
                "probably another (time.unit); if not, thin the log out first."
            )
        steps = np.diff(one.times)
        widths = np.where((one.times[1:] > start) & (one.times[:-1] < end), steps, 0.0)
        longest = int(np.argmax(widths))
        allowed = max_gap_seconds if one.oldest is None else one.oldest * (1 + SLACK)
        if widths[longest] > allowed:
            said = one.empty_between(one.times[longest], one.times[longest + 1]) or one.columns
            raise RecordingError(
                f"{one.where}: '{name}'{f' ({said})' if said else ''} has nothing for {widths[longest]:.3g} s, "
                f"from {one.times[longest]:.3f} s on; {_until(one, max_gap_seconds, rate_hz, widths[longest])}"
            )
    where = ", ".join(dict.fromkeys(one.where for one in samples.values()))
    if (end - start) * rate_hz > MOST_SAMPLES:
        raise RecordingError(
            f"{where}: from first to last stamp {end - start:.3g} s pass, {MOST_SAMPLES / rate_hz:.3g} s are the most; "
            "probably the clock jumped, or the unit of the stamps is another (time.unit). Cut the log at the jump."
        )
    count = int(np.floor((end - start) * rate_hz + 1e-6)) + 1 if end > start else 0
    if count < 2:
        raise RecordingError(f"{where}: the channels share no stretch of time. Check the time column and its unit.")
    grid = np.minimum(start + np.arange(count) / rate_hz, end)
    for name, one in samples.items():
        drawn = interpolated(one, grid, rate_hz) if one.oldest is None else 0
        if drawn > MOST_DRAWN * count:
            steps = np.diff(one.times)
            what_to_do = _slow(name, 1.0 / float(steps.max()), name in gauges, control_rate_hz)
            raise RecordingError(
                f"{one.where}: {drawn} of {count} samples of '{name}' would lie on straight lines across gaps between "
                f"its stamps, which are {1 / one.rate_hz:.3g} s apart at the median and {steps.max():.3g} s "
                "at most. Stamps of receipt come in bursts: name those of when it was measured (time.column). "
                f"Else cut the log at its gaps, or {what_to_do}."
            )
    return grid


def _slow(name: str, rate: float, gauge: bool, control_rate_hz: float | None) -> str:
    """What to do with a channel that was logged at `rate`, too slow for what is wanted."""
    if gauge:
        return f"if '{name}' is a gauge whose last reading stands until the next, say resample: hold of it"
    if control_rate_hz is not None and rate < 0.9 * control_rate_hz:
        return (
            f"log '{name}' at {control_rate_hz:g} Hz or faster, the rate of the robot's policy, or leave it out "
            f"of the mapping (hts import: --drop {name})"
        )
    if control_rate_hz is not None:
        return f"set rate_hz to {control_rate_hz:g}, the rate of the robot's policy"
    return f"set rate_hz to {rate:.4g} or less"


def _until(one: Samples, max_gap_seconds: float, rate_hz: float, found: float) -> str:
    """How long a gap may be, and what to do with one that is longer, `found` s."""
    if one.oldest is None:
        runs = ", make two recordings of it (runs: {gap_seconds: 1})" if found > 1 else ""
        return (
            f"gaps up to {max_gap_seconds:g} s are filled. Cut the log there{runs}, or raise max_gap_seconds if that "
            "is harmless."
        )
    unit = " If it is faster than that, correct time.unit." if TOO_SLOW * one.rate_hz < rate_hz else ""
    return (
        f"a reading of it is held for up to {one.oldest:.3g} s (it comes at {one.rate_hz:.4g} Hz). Cut the log there, "
        f"or state its max_age_seconds if older readings are harmless.{unit}"
    )


def resampled(samples: Samples, grid: np.ndarray, rate_hz: float, how: str = "interpolate") -> np.ndarray:
    """Values (T, k) on the grid (T,), s.

    how: "interpolate", the value at each instant; "mean", over one period; "hold", the last sample at or before it.
    """
    if how == "hold":
        return hold(samples.times, samples.values, grid, SLACK / rate_hz)
    if how == "mean":
        return window_mean(samples.times, samples.values, grid, 1.0 / rate_hz)
    return interpolate(samples.times, samples.values, grid)


def interpolated(samples: Samples, grid: np.ndarray, rate_hz: float) -> int:
    """How many instants of the grid lie inside a gap of the log, where only a straight line says what was."""
    after = np.clip(np.searchsorted(samples.times, grid, side="left"), 1, len(samples.times) - 1)
    low, high = samples.times[after - 1], samples.times[after]
    slack = SLACK / rate_hz
    inside = (grid > low + slack) & (grid < high - slack) & (high - low > GAP / rate_hz)
    return int(inside.sum())
