"""Whether the robot's accumulator was exchanged within one recording: its charge steps up, and its voltage with it.

At another voltage the same work takes another current, and electronics idle at another one, so what is measured before
and after is not to be compared, and one idle level is not that of both.

A charge falls while a robot works, and where it is counted, not measured, it does not rise at all; many gauges guess it
from the voltage, though, which recovers where a load ends. So the step has to be a large one, of both, and is not
looked for where the joints cease to move. Six lithium cells at rest have 22.5 V at 30 %, 23.0 at 60, 23.7 at 80 and
24.6 at 100 (an OCV curve of 18650 cells): an exchange at 80 % is 4 % of the voltage, and one at 30 is 9.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping

import numpy as np

from hts import units
from hts.recordings.recording import Series
from hts.recordings.repeated import moving

LEAST_CHARGE = 10.0
"""Percent, of the whole, by which the charge steps up."""
LEAST_VOLTAGE = 0.03
"""As a share of the voltage before."""
BLOCK_SECONDS, SIDE = 0.5, 5
"""Levels are medians of SIDE blocks before and after a moment, 2.5 s."""
LAG_SECONDS = 10.0
"""By which one of the two may be shown later than the other: gauges of a charge are slow."""


def exchanged_notes(channels: Mapping[str, Series], rate_hz: float, stated: Collection[str] = ()) -> dict[str, str]:
    """A note where the charge (a single number in %, or a share from 0 to 1) steps up and a voltage with it.

    stated: names of channels whose limits a mapping states, which is a person's word for them.
    """
    block = max(1, round(BLOCK_SECONDS * rate_hz))
    single = {name: one for name, one in channels.items() if one.values.ndim == 1 and name not in stated}
    voltages = {name: one for name, one in single.items() if units.one_quantity(one.channel.unit, "V")}
    walks = moving(channels, rate_hz)
    for name, series in single.items():
        percent = _percent(series)
        if percent is None or len(percent) < 2 * SIDE * block:
            continue
        low, high = _sides(_as_shown(percent), block)
        at = _middle_of_largest(high - low)
        if high[at] - low[at] < LEAST_CHARGE:
            continue
        near = np.abs(np.arange(len(low)) - at) * block / rate_hz <= LAG_SECONDS
        if walks is not None:
            before, after = _sides(walks.astype(np.float64), block)
            ends = np.convolve((before > 0.5) & (after < 0.5), np.ones(2 * SIDE + 1))[SIDE:-SIDE] > 0
            near &= ~ends  # where a load ends a voltage recovers
        for volts, one in voltages.items():
            less, more = _sides(_as_shown(one.values.astype(np.float64)), block)
            steps = np.where(near & (less > 0), more - less, -np.inf)
            when = _middle_of_largest(steps)
            if steps[when] >= LEAST_VOLTAGE * less[when]:
                return {
                    "accumulator_exchanged": (
                        f"{name} steps up from {low[at]:.3g} to {high[at]:.3g} % at about "
                        f"{(at + SIDE) * block / rate_hz:.0f} s, and {volts} from {less[when]:.3g} to "
                        f"{more[when]:.3g} {one.channel.unit}: was it exchanged? The same work takes another current "
                        "then: cut the log there, and measure the idle level with each"
                    )
                }
    return {}


def _percent(series: Series) -> np.ndarray | None:
    """Values (T,) of what may be a charge, in %; None of anything else."""
    scale = {"%": 1.0, "1": 100.0}.get(series.channel.unit)
    if scale is None:
        return None
    values = scale * series.values.astype(np.float64)
    return values if values.min() >= 0 and values.max() <= 100 else None


def _as_shown(values: np.ndarray) -> np.ndarray:
    """Values (T,) in which a gauge that shows 0, as one that is not there for the time of an exchange may, still shows
    what it did before."""
    shown = np.maximum.accumulate(np.where(values != 0, np.arange(len(values)), 0))
    return np.asarray(values[shown])


def _sides(values: np.ndarray, block: int) -> tuple[np.ndarray, np.ndarray]:
    """Levels before and after each moment between blocks that has SIDE of them on either side. values: (T,)."""
    whole = values[: len(values) // block * block].reshape(-1, block)
    blocks = np.median(whole, axis=1)
    levels = np.median(np.lib.stride_tricks.sliding_window_view(blocks, SIDE), axis=1)
    return levels[:-SIDE], levels[SIDE:]


def _middle_of_largest(steps: np.ndarray) -> int:
    """Where the largest step is; a sharp one looks the same from some blocks around it."""
    largest = np.flatnonzero(steps == steps.max())
    return int(largest[len(largest) // 2])
