"""Whether recordings of a store, or of two, belong together: one robot, one rate, the same joints, the same units."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING

from hts.errors import RecordingError
from hts.units import same_unit

if TYPE_CHECKING:
    from hts.recordings.recording import Recording


def check_alike(recordings: Sequence[Recording], channels: Sequence[str]) -> None:
    """Raise RecordingError, one line with how many there are of each, for recordings that no one model is for."""
    facts: dict[str, tuple[Callable[[Recording], object], str]] = {
        "robot": (lambda one: one.robot, "Fit one robot's at a time: --robot NAME"),
        "rate in Hz": (lambda one: f"{one.rate_hz:g}", "A model counts in samples: import all at one rate_hz"),
        "joints": (
            lambda one: ", ".join(one.joint_names),
            "Import all with the joints of one robot, in one order",
        ),
    }
    for name in channels:
        facts[f"shape of '{name}'"] = (partial(_shape, name), "Import all with one mapping")
    for what, (fact, remedy) in facts.items():
        groups: dict[object, list[Recording]] = {}
        for recording in recordings:
            groups.setdefault(fact(recording), []).append(recording)
        if len(groups) > 1:
            raise _unlike(what, {str(key): group for key, group in groups.items()}, remedy)
    for name in channels:
        first = recordings[0].channels[name].channel.unit
        units: dict[str, list[Recording]] = {}
        for recording in recordings:
            unit = recording.channels[name].channel.unit
            units.setdefault(first if same_unit(unit, first) else unit, []).append(recording)
        if len(units) > 1:
            raise _unlike(f"unit of '{name}'", units, "Import the logs again, so that all are in one")


def _shape(name: str, recording: Recording) -> tuple[int, ...]:
    return recording.channels[name].channel.shape


def _unlike(what: str, groups: dict[str, list[Recording]], remedy: str) -> RecordingError:
    found = "; ".join(
        f"{key} in {len(group)} recording{'s' if len(group) > 1 else ''} ({group[0].id or 'not stored'}"
        f"{', …' if len(group) > 1 else ''})"
        for key, group in groups.items()
    )
    return RecordingError(f"The recordings differ in {what}: {found}. {remedy}.")
