"""Whether a store has a recording's data already, whatever its notes say.

A recording's id vouches for its notes too, so a log that was imported by a version of hts that noticed less would get
another id today, and be there twice. An import therefore asks for the data first.
"""

from __future__ import annotations

import contextlib
import json
from typing import Any

from hts.errors import RecordingError
from hts.recordings.header import to_attributes
from hts.recordings.recording import Recording
from hts.recordings.store import RecordingStore

NOT_DATA = ("schema_version", "notes", "arrays")
OF_AN_ARRAY = ("unit", "rate_hz", "shape", "sha256")
"""What is data of an array; its description is words."""


class Known:
    """The data of a store, as it is when this is made. Damaged recordings are passed over: `hts data validate` names
    them."""

    def __init__(self, store: RecordingStore) -> None:
        self._there: dict[str, dict[str, Any]] = {}
        for recording_id in store.ids():
            with contextlib.suppress(RecordingError):
                attributes = store.attributes(recording_id)
                self._there.setdefault(_identity(attributes), {})[recording_id] = attributes["notes"]

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
