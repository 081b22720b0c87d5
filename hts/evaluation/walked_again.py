"""Held speeds that are walked again because trimming did not find the commands: in trials and in the final."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

from hts.contracts import HoldSpeed
from hts.recordings.recording import Recording, robot_samples_of

LONGEST = 4.0  # of the first trimming: what still moves the speed then is no noise that a longer one averages out


def walked_again(
    first: Sequence[Recording],
    hold: HoldSpeed,
    most: int,
    missed: Callable[[Sequence[Recording]], Sequence[float]],
    ask: Callable[[HoldSpeed, Sequence[float]], Sequence[Recording]],
    room: float = math.inf,
) -> tuple[list[Recording], list[Recording]]:
    """The recordings that count, and those that were made in vain.

    first: of the first time, held by `hold`; missed(recordings): the speeds, m/s, whose commands were not found;
    ask(hold, speeds): recordings of those alone. Up to `most` times, trimmed twice as long each time, up to LONGEST
    times; not once more where twice the real samples of the last time do not fit into the room. Whether commands were
    found says nothing about what is saved with them, so each try is a fair one. `hold.again` counts on: where these
    speeds of these policies may have been asked for alone before, begin above the last time.
    """
    good, vain, longest = list(first), [], LONGEST * hold.seconds
    for again in range(hold.again + 1, hold.again + most + 1):
        speeds = missed(good)
        old = [recording for recording in good if _asked(recording) in speeds]
        if not speeds or 2 * robot_samples_of(old) > room:  # it is trimmed longer now
            break
        hold = replace(hold, seconds=min(2 * hold.seconds, longest), again=again)
        new = ask(hold, speeds)
        room -= robot_samples_of(new)
        vain += old
        good = [*(recording for recording in good if _asked(recording) not in speeds), *new]
    return good, vain


def _asked(recording: Recording) -> float:
    return recording.schedule.commands[0].commanded
