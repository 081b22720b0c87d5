"""A measured channel that keeps one number while the robot moves: its sensor was no longer being read.

Costs are means of such a channel, so 18 of 20 s of one low reading look like a policy that saves.

Where the numbers come from: the current monitor of a quadruped that stood gave one number for 0.88 s at most, simulated
gauges, down to the slowest and coarsest that is drawn, for 1.24 s; 3 s is also when a row of a visit ends by itself
(`frozen_real_seconds`, docs/deployment.md). Joints of simulated walks at 0.65 to 0.85 m/s move at 1.9 to 2.3 rad/s,
root mean square.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping

import numpy as np

from hts import units
from hts.errors import RecordingError
from hts.recordings.coarse import Walk, stands_by_resolution
from hts.recordings.recording import Series
from hts.recordings.repeated import MOVING, pace_of, runs_of

LONGEST_SECONDS = 3.0
"""Of moving, in which what is measured has to change; one reading a second may then come out alike twice."""
SAME = 1e-6
"""As a share of the largest value: what resampling leaves of a difference of nothing."""


def check_read(
    channels: Mapping[str, Series],
    rate_hz: float,
    measured: Collection[str],
    where: str,
    slow: Mapping[str, tuple[float, float]] | None = None,
    longest_seconds: float = LONGEST_SECONDS,
) -> None:
    """Raise RecordingError for a measured channel that is the same for more than `longest_seconds` of moving joints; 0:
    never. A coarse and slow gauge on a steady walk is not refused (`coarse`).

    measured: names of what only the robot gives; where: begins the message; slow: of gauges whose readings are held,
    name -> seconds between two of them, by which that is more, and for which one may stand, which is not refused.
    Nothing is said of voltages, which may stay as they are within the resolution of a cheap monitor, of what
    `may_be_constant`, nor of a log without joints.
    """
    pace = pace_of(channels, rate_hz)
    if pace is None or longest_seconds == 0:
        return
    walks = pace > MOVING
    single = [
        one for one in channels.values() if one.values.shape == pace.shape and units.one_quantity(one.channel.unit, "V")
    ]
    walk = Walk(walks, pace, [one.values for one in single], rate_hz)
    for name in measured:
        series = channels[name]
        unit = series.channel.unit
        if series.channel.may_be_constant or len(series.values) != len(walks) or units.one_quantity(unit, "V"):
            continue
        values = series.values.reshape(len(walks), -1).astype(np.float64)
        tolerance = SAME * float(np.abs(values).max())
        same = (np.abs(np.diff(values, axis=0)) <= tolerance).all(axis=1)
        period, stands = (slow or {}).get(name, (0.0, 0.0))
        longest = max(longest_seconds + period, stands)
        for first, last in runs_of(np.asarray(same)):
            moved = float(walks[first + 1 : last + 1].sum()) / rate_hz
            coarse = moved > longest and values.shape[1] == 1
            if coarse and stands_by_resolution(values[:, 0], (first, last), walk, longest, tolerance):
                continue
            if moved > longest:
                number = f"{values[first, 0]:g} {unit}"
                stays = f"is {number}" if values.shape[1] == 1 else "keeps the numbers of all its components"
                raise RecordingError(
                    f"{where}: '{name}' {stays} from {first / rate_hz:.2f} to "
                    f"{last / rate_hz:.2f} s while the joints move for {moved:.1f} s of that. Expected another number "
                    f"after at most {longest:g} s: the sensor was probably not being read. Record again, or cut the "
                    f"log there; if '{name}' may honestly stand still for so long, say may_be_constant: true of it in "
                    "the mapping, or for how long there: frozen_real_seconds."
                )
