"""Holding the speed by hand: what a person is told, and what of it the logs must show."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hts.contracts import FollowVelocity, HoldSpeed, Task
from hts.errors import ConfigError, RecordingError
from hts.recordings.recording import Recording
from hts.recordings.unread import LONGEST_SECONDS, check_read

SPEED_CHANNEL = "base_velocity"
FELL_WHILE_TRIMMED = "fell_while_trimmed"
"""Note of a log that holds the trimming in which the robot fell: no command had been frozen yet."""
STEADY = 0.005  # m/s: a command that moves by more than a joystick's and a log's resolution was not frozen
SENSOR = (
    "a sensor of the trunk's speed that is good to 1 % on average: motion capture, a camera above the track, or a "
    "tracking camera; not odometry from the legs, which slips as the gait does"
)


def instructions(hold: HoldSpeed, runtime: bool) -> list[str]:
    """A section of the bundle's README, in lines. runtime: whether one does the rows, and so what is told here."""
    low, high = hold.commands
    steps = (
        f"1. Before a row marked *trim first*, walk with its policy for {hold.seconds:g} s. Begin with the table's "
        "speed as the command; after 2 s add (asked − measured mean speed) to the command, and again, until the mean "
        f"agrees within {hold.tolerance:.0%}.\n"
        "2. Then leave the command alone: all rows of this policy at this speed in this bundle are recorded with it.\n"
        f"3. Stay between {low:g} and {high:g} m/s. Where that is not enough, record at the limit: it is refused then, "
        "and says so.\n"
        "4. The log's `command` must hold what was sent: what you froze is read from it."
    )
    about = f"The table's speed is the one to be *measured*. You need {SENSOR}; it is the column of `{SPEED_CHANNEL}`."
    if runtime:
        about += " The runtime does the steps below by itself."
    return ["## Hold the speed", "", about, "", steps, "", "## Then", ""]


def check_mapping(path: Path, mapping: Mapping[str, Any]) -> None:
    """Raise ConfigError if the logs will not show what holding the speed needs."""
    channels = mapping.get("channels")
    for name, why in ((SPEED_CHANNEL, f"It takes {SENSOR}."), ("command", "It is what was sent to the robot.")):
        if isinstance(channels, Mapping) and name not in channels:
            raise ConfigError(f"{path}: holding the speed needs the channel '{name}', which is not there. {why}")


def check_speed_read(file: Path, recording: Recording, task: Task, mapping: Mapping[str, Any]) -> None:
    """Raise RecordingError if the trunk's speed keeps one number while the joints move: a tracker that has lost the
    robot repeats where it was last, and then that is, or is not, the speed asked for, whatever the robot does.

    mapping: for how long it may. After a fall nobody sees the markers, and nothing is asked.
    """
    said = mapping["channels"].get(SPEED_CHANNEL) or {}
    if not isinstance(task, FollowVelocity) or recording.fell or said.get("may_be_constant"):
        return
    longest = mapping.get("frozen_real_seconds", LONGEST_SECONDS)
    check_read(recording.channels, recording.rate_hz, (SPEED_CHANNEL,), str(file), None, longest)


def held(files: Sequence[Path], recording: Recording, hold: HoldSpeed, trimmed: bool) -> Recording:
    """The recording of a block with its notes of the held speed, read from its channel `command`.

    trimmed: whether this block's policy was trimmed just before. A log that notes FELL_WHILE_TRIMMED holds that alone.
    Raises RecordingError, one line, if the command was not frozen, left its range, or was not logged.
    """
    path, asked = files[0], recording.schedule.commands[0].vx
    for name in ("command", SPEED_CHANNEL):
        if name not in recording.channels:
            raise RecordingError(f"{path}: has no channel '{name}', without which no held speed can be checked.")
    sent = np.asarray(recording.channels["command"].values)[:, 0]
    command, moved = float(np.median(sent)), float(sent.max() - sent.min())
    if FELL_WHILE_TRIMMED in recording.notes:
        notes = {"held_command": repr(command), "held_saturated": "false", "unrecorded_seconds": "0"}
        return recording.replace(notes={**recording.notes, **notes})
    if moved > 2 * STEADY:
        raise RecordingError(
            f"{path}: the command moves between {sent.min():.3f} and {sent.max():.3f} m/s, but it was to be frozen for "
            f"the whole block ({asked:g} m/s asked). Cut the trimming off the log, or record the block again."
        )
    low, high = hold.within(asked)
    if not low - STEADY <= command <= high + STEADY:
        raise RecordingError(
            f"{path}: the command is {command:.3f} m/s, allowed are {low:g} to {high:g}. Trim again inside, and record "
            "at the limit if that is not enough."
        )
    at_limit = command <= low + STEADY or command >= high - STEADY
    notes = {
        "held_command": repr(command),
        "held_saturated": "true" if at_limit else "false",
        "unrecorded_seconds": f"{hold.seconds if trimmed else 0.0:g}",
    }
    return recording.replace(notes={**recording.notes, **notes})


def check_one_command(recordings: Sequence[Recording]) -> None:
    """Raise RecordingError if a policy's blocks at one speed of one session had different commands."""
    first: dict[tuple[str, str, float], float] = {}
    for recording in recordings:
        if "held_command" not in recording.notes or FELL_WHILE_TRIMMED in recording.notes:
            continue
        asked, command = recording.schedule.commands[0].vx, float(recording.notes["held_command"])
        known = first.setdefault((recording.session, recording.role + recording.policy_hash, asked), command)
        if abs(known - command) > STEADY:
            raise RecordingError(
                f"Session {recording.session}, block {recording.block}: the {recording.role} got {command:.3f} m/s "
                f"after {known:.3f} in an earlier block at {asked:g} m/s. One command is frozen for all of its blocks: "
                "record them again."
            )
