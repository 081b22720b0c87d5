"""Stores that somebody else wrote, hashes and all: a name is no path, a shape takes no memory, a fault is one line."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from hts.channels import Channel
from hts.errors import RecordingError
from hts.recordings.header import content_id
from hts.recordings.store import RecordingStore
from hts.testing.made_up_recordings import made_up_recording


@pytest.fixture
def store(tmp_path) -> RecordingStore:
    store = RecordingStore(tmp_path / "data.zarr", create=True)
    store.write(made_up_recording({"draw": Channel("draw", "A")}, {}))
    return store


def rewritten(store: RecordingStore, change) -> str:
    """The recording with changed attributes under the id that these deserve, as its author would have named it."""
    (name,) = store.ids()
    file = store.path / name / "zarr.json"
    group = json.loads(file.read_text())
    change(group["attributes"])
    file.write_text(json.dumps(group))
    new = content_id(group["attributes"])
    file.parent.rename(store.path / new)
    return new


def renamed(old: str, new: str):
    def change(attributes):
        attributes["arrays"][new] = attributes["arrays"].pop(old)

    return change


def with_shape(shape):
    def change(attributes):
        attributes["arrays"]["draw"]["shape"] = shape

    return change


def with_unit(unit):
    def change(attributes):
        attributes["arrays"]["draw"]["unit"] = unit

    return change


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (renamed("draw", "../../../secret"), "an array named '../../../secret', expected letters, digits and _"),
        (renamed("draw", "/etc/passwd"), "an array named '/etc/passwd'"),
        (renamed("draw", "a" * 300), "an array named 'aaaa"),
        (renamed("time", "clock"), "no 'arrays' with a 'time'"),
        (with_shape([1 << 60]), "'draw' of 5.76e[+]20 numbers, more than any recording"),
        (with_shape([-1]), "'draw' of shape"),
        (with_shape("()"), "'draw' of shape"),
        (with_unit(3), "'draw' without unit or hash"),
        (with_unit("\n" * 5), "No unit named"),
        (lambda attributes: attributes.update(samples=0), "samples 0"),
        (lambda attributes: attributes.update(arrays=[]), "no 'arrays'"),
        (lambda attributes: attributes.pop("kp"), "not the attributes of a recording .KeyError: 'kp'"),
        (lambda attributes: attributes.update(schedule={}), "not the attributes of a recording"),
    ],
)
def test_attributes_that_fit_their_id_and_nothing_else_are_refused(store, change, words):
    name = rewritten(store, change)
    with pytest.raises(RecordingError, match=words) as caught:
        store.read(name)
    assert "\n" not in str(caught.value)
    if "not the attributes" not in words and "unit named" not in words:  # those are only looked at when it is read
        assert store.validate()


@pytest.mark.parametrize(
    "change",
    [
        {"shape": [1 << 40]},
        {"chunk_grid": {"name": "regular", "configuration": {"chunk_shape": [1 << 50]}}},
        {"data_type": "complex128"},
    ],
)
def test_an_array_that_asks_for_more_than_there_is_gets_no_memory(store, change):
    (name,) = store.ids()
    file = store.path / name / "draw" / "zarr.json"
    file.write_text(json.dumps({**json.loads(file.read_text()), **change}))
    with pytest.raises(RecordingError, match=r"draw: damaged \(ValueError: its (shape|data type) is"):
        store.read(name)


def test_nothing_outside_the_store_is_opened(store, monkeypatch):
    opened = []
    read = Path.read_bytes
    monkeypatch.setattr(Path, "read_bytes", lambda path: opened.append(path) or read(path))
    name = rewritten(store, renamed("draw", "../../../secret"))
    with pytest.raises(RecordingError):
        store.read(name)
    assert opened and all(path.resolve().is_relative_to(store.path.resolve()) for path in opened)


def test_an_ordinary_recording_is_read_as_before(store):
    (name,) = store.ids()
    assert np.isfinite(store.read(name).values("draw")).all() and store.validate() == []
