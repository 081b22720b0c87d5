"""Whether the trunk turns as it was told: a commanded yaw rate in deg/s, or a gyroscope whose z goes the other way.

Neither shows anywhere else: gravity does not tell how the trunk turns about it, and a command may be anything. On the
default simulated robot and 16 drawn ones, told 0.4 to 0.6 rad/s to either side, the trunk turned 0.80 to 0.97 times as
fast as it was told.
"""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from hts.errors import RecordingError
from hts.recordings.base_speed import COMMAND, LEAST_SECONDS, mean_over, told_commands, unchanged
from hts.recordings.recording import Recording
from hts.recordings.turning import TURNING

TOLD = 0.3
"""rad/s: who is told less may keep its heading."""
THE_OTHER_WAY = -0.5
"""Times as fast as it was told: who turns so was told otherwise."""
OTHER_UNIT = 10.0
"""From which on the gyroscope is in another unit; deg/s are 57 times rad/s."""
NOBODY = 3.0
"""rad/s, half a turn a second. Told that much, robots either turn fast or were told in deg/s."""
TURNED = 0.15
"""rad/s: with less the trunk may not turn at all, and a gyroscope be biased."""
IN_DEGREES = (0.5 * np.pi / 180, 2 * np.pi / 180)
"""Times as fast as it was told, of a command in deg/s: robots follow it to within a factor of two."""


def check_told_turn(recording: Recording, where: str, stated: Collection[str] = ()) -> None:
    """Raise RecordingError where the trunk turns otherwise than it was told for some seconds, and another unit or sign
    explains it. What was told is the channel `command`, else the schedule, if somebody stated it.

    where: begins the message; stated: names of channels whose limits a mapping states, which is a person's word for
    them. Nothing is said of a fall, nor of a robot that turns less than it was told.
    """
    if recording.fell or TURNING not in recording.channels or {TURNING, COMMAND} & {*stated}:
        return
    series = recording.channels[TURNING]
    told = told_commands(recording)
    if told is None or series.channel.unit != "rad/s" or series.values.shape[1:] != (3,):
        return
    steady = unchanged(told, recording.rate_hz) & (np.abs(told[:, 2]) >= TOLD)
    if steady.sum() < LEAST_SECONDS * recording.rate_hz:
        return
    turned = mean_over(series.values[:, 2:].astype(np.float64), round(recording.rate_hz))[steady, 0]
    asked = told[steady, 2]
    share = float((turned * asked).sum() / (asked**2).sum())
    size = float(np.sqrt((asked**2).mean()))
    if share > OTHER_UNIT:
        hint = f"'{TURNING}' is in another unit (deg/s are 57 times rad/s): correct its unit or scale"
    elif share < THE_OTHER_WAY:
        hint = (
            f"one of the two is counted the other way. Expected is to the left positive, seen from above: correct the "
            f"yaw rate of '{COMMAND}' or of the schedule, or z of '{TURNING}'"
        )
    elif size > NOBODY and IN_DEGREES[0] < share < IN_DEGREES[1] and float(np.sqrt((turned**2).mean())) > TURNED:
        hint = (
            f"the commanded yaw rate is probably in deg/s. Expected rad/s, {size * np.pi / 180:.2g} of them: convert "
            f"it in the log, or in the schedule (the third number of '{COMMAND}' has no unit of its own)"
        )
    else:
        return
    raise RecordingError(
        f"{where}: told to turn by {size:.3g} rad/s, the trunk turns {share:.2g} times as fast ('{TURNING}' about z, "
        f"{steady.sum() / recording.rate_hz:.3g} s in which that was told): {hint}; if it is right, say so with "
        "`limits`."
    )
