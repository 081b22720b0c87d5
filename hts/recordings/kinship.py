"""Recordings of one store go together: one robot with its joints, one rate, one unit for each channel.

A model is fitted to a whole store. What differs would be refused then, long after the robot was put away.
"""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from typing import Any

from hts.errors import RecordingError
from hts.recordings.header import to_attributes
from hts.recordings.recording import Recording
from hts.recordings.store import RecordingStore
from hts.units import same_unit


def check_kinship(store: RecordingStore | None, recordings: Sequence[Recording]) -> None:
    """Raise RecordingError for recordings that do not go with each other or with those of the store,
    None for a new one.

    Damaged recordings of the store are passed over: `hts data validate` names them.
    """
    known: list[tuple[str, dict[str, Any]]] = []
    if store is not None:
        for recording_id in store.ids():
            with contextlib.suppress(RecordingError):
                known.append((f"{store.path}: its recording {recording_id}", store.attributes(recording_id)))
    for one in recordings:
        attributes = to_attributes(one)
        name = str(one.notes.get("source", "a recording"))
        for other, theirs in known:
            difference = differs(attributes, theirs)
            if difference:
                raise RecordingError(
                    f"{name}: {difference[0]}, but {other} {difference[1]}. Correct the mapping, or import into "
                    "another store: a model is fitted to all of one."
                )
        known.append((name, attributes))


def differs(one: dict[str, Any], other: dict[str, Any]) -> tuple[str, str] | None:
    """The first thing in which the attributes of two recordings do not go together, as told of each; None if
    nothing."""
    if one["robot"] != other["robot"]:
        return f"it is of robot '{one['robot']}'", f"of '{other['robot']}'"
    if one["joint_names"] != other["joint_names"]:
        return f"its joints are {', '.join(one['joint_names'])}", f"has {', '.join(other['joint_names'])}"
    if one["rate_hz"] != other["rate_hz"]:
        return f"it has {one['rate_hz']:g} Hz", f"has {other['rate_hz']:g} Hz"
    for name, about in one["arrays"].items():
        theirs = other["arrays"].get(name)
        if theirs is None:
            continue
        if not same_unit(about["unit"], theirs["unit"]):
            return f"its '{name}' is in {about['unit']}", f"has it in {theirs['unit']}"
        if about["shape"] != theirs["shape"]:
            return f"its '{name}' has {about['shape']} numbers", f"has {theirs['shape']}"
    return None
