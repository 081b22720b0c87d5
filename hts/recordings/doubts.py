"""Doubts about values that are taken all the same: notes of an import that somebody should read before going on."""

from __future__ import annotations

from collections.abc import Sequence

from hts.recordings.commanded import excess, shortfall
from hts.recordings.recording import Recording

DOUBTS = (
    "joint_torque_scale",
    "joint_torque_late",
    "joint_torque_unlike",
    "joint_torque_takes_work",
    "base_velocity_scale",
    "repeated_while_moving",
    "gravity_stands_still",
    "angular_velocity_axes",
    "foot_force_scale",
    "foot_force_legs",
    "temperature_unit",
    "accumulator_exchanged",
    "idle_differs",
    "blocks_unlike",
    "recorded_apart",
    "walked_in_another_order",
    "logs_overlap",
)
"""Names of the notes of `torque_notes`, `work_notes`, `velocity_notes`, `repeated_notes`, `still_notes`, `axes_notes`,
`foot_notes`, `temperature_notes` and `exchanged_notes`, and those of a world whose recordings are compared although
they state idle levels that differ, measure what is far apart, or lie long after each other, in another order than
planned or over one another."""


def remarks(recordings: Sequence[Recording]) -> list[str]:
    """What is said of recordings where they are stored, a line each: which end before their schedules or go on after
    them, and what is doubtful of them."""
    lengths = (shortfall(recordings), excess(recordings))
    return [*(line for line in lengths if line is not None), *doubts(recordings)]


def doubts(recordings: Sequence[Recording]) -> list[str]:
    """One line for each kind of doubt that the notes tell of: in how many recordings, and what is said of the first."""
    lines = []
    for name in DOUBTS:
        told = [one for one in recordings if name in one.notes]
        if not told:
            continue
        first = told[0].notes.get("source", "a recording")
        who = first if len(recordings) == 1 else f"{len(told)} of {len(recordings)} recordings, the first {first}"
        lines.append(f"note: {name} of {who}: {told[0].notes[name].rstrip('.')}.".replace("?.", "?"))
    return lines
