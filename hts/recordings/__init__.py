"""Recordings: what they are, where they are kept, and how somebody's logs become some."""

from __future__ import annotations

from hts.recordings.recording import Recording, Series
from hts.recordings.store import Damage, Dataset, RecordingStore

__all__ = ["Damage", "Dataset", "Recording", "RecordingStore", "Series"]
