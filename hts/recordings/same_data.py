"""Whether a store has a recording's data already, whatever its notes say.

A recording's id vouches for its notes too, so a log that was imported by a version of hts that noticed less would get
another id today, and be there twice. An import therefore asks for the data first.

The same samples under another name, or with other stated facts, are another recording: who corrects a mass wants that.
But then one walk is there twice, and somebody has to be told, who may have copied a file, or taken the mapping of
another log.
"""

from __future__ import annotations

import contextlib
import json
from typing import Any

import numpy as np

from hts.errors import RecordingError
from hts.recordings.header import to_attributes
from hts.recordings.recording import Recording
from hts.recordings.store import RecordingStore

NOT_DATA = ("schema_version", "notes", "arrays")
OF_AN_ARRAY = ("unit", "rate_hz", "shape", "sha256")
"""What is data of an array; its description is words."""
JOINTS = ("joint_position", "joint_velocity", "joint_torque")
"""Channels that no two walks have alike, as what only the robot measures; commands and targets may be played again."""


class Known:
    """The data of a store, as it is when this is made. Damaged recordings are passed over: `hts data validate` names
    them."""

    def __init__(self, store: RecordingStore) -> None:
        self._there: dict[str, dict[str, Any]] = {}
        self._walks: dict[tuple[str, str], tuple[str, str]] = {}
        for recording_id in store.ids():
            with contextlib.suppress(RecordingError):
                self._take(recording_id, store.attributes(recording_id))

    def add(self, recording_id: str, recording: Recording) -> None:
        """One that was stored since."""
        self._take(recording_id, to_attributes(recording))

    def _take(self, recording_id: str, attributes: dict[str, Any]) -> None:
        self._there.setdefault(_identity(attributes), {})[recording_id] = attributes["notes"]
        source = str(attributes["notes"].get("source", recording_id))
        for name, one in attributes["arrays"].items():
            self._walks.setdefault((name, one["sha256"]), (recording_id, source))

    def walk_of(self, recording: Recording) -> tuple[str, str, str] | None:
        """Id and source of a stored recording that holds the same samples of a channel which no two walks have alike,
        and that channel; None if there is none, or if the recording itself is there (`find`)."""
        if self.find(recording) is not None:
            return None
        arrays = to_attributes(recording)["arrays"]
        for name, series in recording.channels.items():
            if (name in recording.idle or name in JOINTS) and np.ptp(series.values, axis=0).all():
                found = self._walks.get((name, arrays[name]["sha256"]))
                if found is not None:
                    return (*found, name)
        return None

    def find(self, recording: Recording) -> tuple[str, bool] | None:
        """The id of a stored recording of the same channels, times, values, stated facts and source (the note of that
        name), and whether its notes are the same too; None if there is none."""
        attributes = to_attributes(recording)
        there = self._there.get(_identity(attributes), {})
        for recording_id, notes in there.items():
            if notes == attributes["notes"]:
                return recording_id, True
        return (next(iter(there)), False) if there else None


def _identity(attributes: dict[str, Any]) -> str:
    """What attributes say but for words that hts adds: equal for the same data."""
    facts = {key: value for key, value in attributes.items() if key not in NOT_DATA}
    arrays = {name: [one[key] for key in OF_AN_ARRAY] for name, one in attributes["arrays"].items()}
    source = attributes["notes"].get("source")
    return json.dumps([facts, arrays, source], sort_keys=True)
