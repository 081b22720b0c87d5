"""What is measured in the rows of one comparison, row against row: blocks of one policy are alike, and no policy takes
several times what the other takes.

A log by itself may be right: 45 A is a current. Beside three other blocks with 4.5 A it is a monitor in another range,
and a voltage that is a tenth higher in one block than in the others is another pack, or another meter. Both would go
straight into what is saved.

Where the numbers come from: blocks of 16 s of one policy in one visit of the stand-in (three drawn robots, ten
sessions) differ by a tenth of what walking adds to the idle level at most, their voltages by 1.3 %. The most that a
fine-tuned policy was found to save is a little more than half of what walking adds.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from hts import units
from hts.recordings.recording import Recording

NOTE = "blocks_unlike"
OF_ONE_POLICY, OF_TWO = 0.4, 3.0
"""Of what walking adds to the idle level, of the block that adds less: blocks of one policy, and of policy and
reference, that differ by more are told of. Three times more is three quarters saved, or a fourfold loss."""
LEAST = 0.05
"""Of the level itself: what differs by less is told of in no case. A level near its idle one adds next to nothing."""


def with_alike_blocks(recordings: Sequence[Recording], names: Sequence[str]) -> list[Recording]:
    """The recordings, with a NOTE where real channels of one session are far apart between its rows: it is among the
    doubts that are told.

    names: of the rows. Nothing is said of temperatures, which drift by as much as walking adds, nor of falls.
    """
    sessions: dict[str, list[int]] = {}
    for number, recording in enumerate(recordings):
        if not recording.fell and recording.role != "collection":
            sessions.setdefault(recording.session, []).append(number)
    found = list(recordings)
    for session, rows in sessions.items():
        said = [
            text
            for channel in sorted(_measured(recordings, rows))
            if (text := _apart(channel, recordings, rows, names))
        ]
        for row in rows if said else ():
            text = f"session {session}: {'; '.join(said)}"
            found[row] = found[row].replace(notes={**found[row].notes, NOTE: text})
    return found


def _measured(recordings: Sequence[Recording], rows: Sequence[int]) -> set[str]:
    """Real channels that all of the rows have, but temperatures."""
    common = set.intersection(*({*recordings[row].idle} for row in rows))
    return {one for one in common if not units.is_temperature(recordings[rows[0]].channels[one].channel.unit)}


def _apart(channel: str, recordings: Sequence[Recording], rows: Sequence[int], names: Sequence[str]) -> str:
    """What is said of the two rows that are farthest apart by their bound; "" where none are beyond."""
    level = {row: float(recordings[row].values(channel).mean(dtype=np.float64)) for row in rows}
    added = {row: level[row] - recordings[row].idle[channel] for row in rows}
    worst, pair = 1.0, None
    for one, other in combinations(rows, 2):
        most = OF_ONE_POLICY if recordings[one].role == recordings[other].role else OF_TWO
        bound = max(most * min(abs(added[one]), abs(added[other])), LEAST * max(abs(level[one]), abs(level[other])))
        if bound > 0 and (far := abs(added[one] - added[other]) / bound) > worst:
            worst, pair = far, (one, other)
    if pair is None:
        return ""
    one, other = pair
    unit, role = recordings[one].channels[channel].channel.unit, recordings[one].role
    who = f"both of the {role}" if role == recordings[other].role else f"of {role} and {recordings[other].role}"
    return (
        f"'{channel}' is {level[one]:.4g} {unit} in the mean of row {names[one]} and {level[other]:.4g} {unit} in row "
        f"{names[other]}, {who}: is one of them in another unit or range, or was a pack or a sensor changed between "
        "them? Rows of a session are compared with each other"
    )
