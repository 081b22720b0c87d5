"""The schedule that a mapping states against the log: what was commanded must end where the log does.

A last command without end, `seconds` left out or infinite, lasts until the log ends. Anything else is a schedule of
another log: read on, every second would count for a speed that nobody commanded.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from hts.errors import RecordingError
from hts.recordings.recording import Recording
from hts.schedules import ScheduleConfig

SHARE, SECONDS = 0.02, 0.5
"""A log may be longer or shorter than its schedule by this share of it, or by so many seconds if that is more: where it
is cut by hand, and where channels begin a little apart."""
EARLY_SECONDS = 0.1
"""A log is so much shorter, or longer, than its schedule before anything is said of it: a few samples, which rounding
leaves out."""
RUN = ("run", "labels")
"""Begin the notes that say which part of a file a recording is."""
UNFINISHED = ".partial"
"""Begins the last part of the name of a file whose writer was killed."""


def without_end(schedule: Any) -> Any:
    """A schedule as it stands in a mapping, whose last command may leave out `seconds`: then they are infinite."""
    commands = schedule.get("commands") if isinstance(schedule, Mapping) else None
    if not isinstance(commands, Sequence) or isinstance(commands, str) or not commands:
        return schedule
    last = commands[-1]
    if not isinstance(last, Mapping) or "seconds" in last:
        return schedule
    return {**schedule, "commands": [*commands[:-1], {"seconds": math.inf, **last}]}


def until_the_end(schedule: ScheduleConfig, seconds: float, where: str) -> ScheduleConfig:
    """The schedule with a last command that lasts until a log of so many seconds ends, if it had no end.

    where: how the message begins. Raises RecordingError where the log ends before that command.
    """
    if math.isfinite(schedule.seconds):
        return schedule
    *before, last = schedule.commands
    gone = sum(command.seconds for command in before)
    if not gone < seconds:
        raise RecordingError(
            f"{where}: the log lasts {seconds:.2f} s, but in recording.schedule the commands before the last one take "
            f"{gone:g} s. Correct them, or leave out those that the log does not reach."
        )
    return schedule.model_copy(update={"commands": (*before, last.model_copy(update={"seconds": seconds - gone}))})


def ends_early(recording: Recording) -> bool:
    """Whether it is shorter than its schedule by more than EARLY_SECONDS."""
    return recording.seconds < recording.schedule.seconds - EARLY_SECONDS


def shortfall(recordings: Sequence[Recording]) -> str | None:
    """One line about those that are accepted although they end before their schedules do: how many, and how much was
    found and expected of the one that lacks most. None where there are none; where a robot fell, that is known."""
    short = [one for one in recordings if ends_early(one) and not one.fell]
    if not short:
        return None
    worst = max(short, key=lambda one: one.schedule.seconds - one.seconds)
    who = f"{_name(worst)} ends before its schedule does:"
    if len(recordings) > 1:
        who = f"{len(short)} of {len(recordings)} recordings end before their schedules do, most of all {_name(worst)}:"
    return f"note: {who} {worst.seconds:.2f} s of {worst.schedule.seconds:g} s. What is missing counts for nothing."


def excess(recordings: Sequence[Recording]) -> str | None:
    """One line about those that are accepted although they go on after their schedules by more than EARLY_SECONDS: how
    many, and how much was found and expected of the one that goes on longest. None where there are none."""
    long = [one for one in recordings if one.seconds > one.schedule.seconds + EARLY_SECONDS]
    if not long:
        return None
    worst = max(long, key=lambda one: one.seconds - one.schedule.seconds)
    who = f"{_name(worst)} goes on after its schedule:"
    if len(recordings) > 1:
        who = f"{len(long)} of {len(recordings)} recordings go on after their schedules, longest {_name(worst)}:"
    return (
        f"note: {who} {worst.seconds:.2f} s for {worst.schedule.seconds:g} s. What comes after counts in no "
        "comparison, but is learned from under the last command; cut it off if that had ended."
    )


def _name(recording: Recording) -> str:
    return recording.notes.get("source", "a recording")


def check_commanded(recording: Recording, files: Sequence[Path]) -> None:
    """Raise RecordingError if a log and its schedule differ in length by more than SHARE and SECONDS.

    files: those of the log. It may be shorter where the robot fell, or where a file is UNFINISHED.
    """
    stated, found = recording.schedule.seconds, recording.seconds
    if abs(found - stated) <= max(SHARE * stated, SECONDS) + 0.5 / recording.rate_hz:
        return
    ended_early = recording.fell or any(path.suffix.startswith(UNFINISHED) for path in files)
    if found < stated and ended_early:
        return
    where = ", ".join(str(path) for path in files)
    run = next((f" ({key} {text})" for key, text in recording.notes.items() if key.startswith(RUN)), "")
    known = "what was commanded after that is not known" if found > stated else "so it ends before its commands do"
    fell = "" if found > stated else " If the robot fell there, say recording.fell: true."
    raise RecordingError(
        f"{where}{run}: the log lasts {found:.2f} s, its recording.schedule {stated:g} s: {known}. Correct the "
        f"seconds, or leave out those of the last command, which then lasts until the log ends.{fell}"
    )
