"""What was sent against what was asked: a row at equal commands is one whose commands were the schedule's.

A walk at another command, such as a joystick that was not pushed all the way, would count as one at the schedule's. A
row at a held speed has a command of its own, which `field_holding` reads.
"""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np

from hts.errors import RecordingError
from hts.evaluation.segments import BEFORE_FALL_SECONDS, FALLEN_GRAVITY_Z, SETTLE_SECONDS, moments_of_falls
from hts.recordings.on_schedule import samples_at
from hts.recordings.recording import Recording, noted_seconds

CHANNEL = "command"
SHARE, SPEED, TURN = 0.1, 0.05, 0.1
"""The mean of what was sent may differ from the schedule by SHARE of its speed, or by SPEED, m/s, if that is more (a
turn: by SHARE or TURN, rad/s): what a hand on a joystick makes of it, and a limit of how fast commands change. Where no
turn is asked for, whoever walks the robot keeps its heading, so a turn is not compared."""
AXES = ("forward", "sideways", "turning")


def check_sent(file: Path, row: str, recording: Recording) -> None:
    """Raise RecordingError, one line, where the means of the log's commands are not the schedule's. Each stretch counts
    from where it is steady, up to a fall; a log without the channel, or another task's, passes. A note of falls that
    says no times is refused too. file: of the log."""
    commands = recording.schedule.commands
    if CHANNEL not in recording.channels or not all(command.is_velocity for command in commands):
        return
    sent = np.asarray(recording.values(CHANNEL), dtype=np.float64)
    if sent.ndim != 2:
        return
    edges = np.concatenate([[0.0], np.cumsum([command.seconds for command in commands])])
    steady = noted_seconds(recording, "unsteady_seconds", SETTLE_SECONDS)
    end = _sound_until(recording)
    for (begin, stop), command in zip(pairwise(edges.tolist()), commands, strict=True):
        start = begin + min(steady, (stop - begin) / 2)
        first, last = samples_at(recording, [start, min(stop, end)]).tolist()
        asked = (command.vx, command.vy, command.yaw_rate)
        for axis, wanted in enumerate(asked[: sent.shape[1]]):
            if first >= last or (axis == 2 and wanted == 0.0):
                continue
            found = float(sent[first:last, axis].mean())
            turns = axis == 2
            size = abs(wanted) if turns else float(np.hypot(command.vx, command.vy))
            allowed = max(SHARE * size, TURN if turns else SPEED)
            if abs(found - wanted) > allowed:
                unit = "rad/s" if turns else "m/s"
                raise RecordingError(
                    f"{file}: row {row}: '{CHANNEL}' is {found:.3f} {unit} {AXES[axis]} in the mean from {start:g} to "
                    f"{min(stop, end):g} s, but {wanted:g} {unit} were to be sent; expected within {allowed:.2g} "
                    f"{unit}. Put there the log of this row, or record the row again with that command; if the column "
                    f"is not what was sent, correct channels.{CHANNEL} in the mapping, or delete it there."
                )


def _sound_until(recording: Recording) -> float:
    """Until when the log shows the schedule, s after its first sample: a robot that fell is let go and set up again."""
    elapsed = recording.time - recording.time[0]
    end = float(elapsed[-1]) + 1 / recording.rate_hz
    falls = moments_of_falls(recording)
    if "projected_gravity" in recording.channels:
        falls += elapsed[recording.values("projected_gravity")[:, 2] > FALLEN_GRAVITY_Z].tolist()[:1]
    if recording.fell and not falls:
        falls = [end - SETTLE_SECONDS]
    return min([fall - BEFORE_FALL_SECONDS for fall in falls], default=end)
