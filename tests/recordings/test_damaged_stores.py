"""A damaged recording store: what is damaged is named, what is whole stays usable."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest
import zarr
from walker_recording import a_recording

from hts.errors import RecordingError
from hts.recordings import RecordingStore


def damages() -> dict[str, str]:
    return {
        "truncated chunk": "draw: damaged (ValueError: c/0 holds 25 numbers, not 50)",
        "missing chunk": "draw: damaged (FileNotFoundError",
        "flipped bit": "draw: damaged: its samples hash to",
        "missing array": "draw: damaged (FileNotFoundError",
        "garbled array metadata": "draw: damaged (JSONDecodeError",
        "missing zarr.json": "zarr.json: missing",
        "garbled zarr.json": "zarr.json: damaged (JSONDecodeError",
        "changed attribute": "zarr.json: damaged: the attributes are not those that",
        "NaN attribute": "zarr.json: damaged: the attributes are not those that",
        "newer version": "zarr.json: schema version 99, this hts reads 1",
    }


def damage(name: str, folder: Path) -> None:
    chunk, header = folder / "draw" / "c" / "0", folder / "zarr.json"
    content = chunk.read_bytes()
    attributes = json.loads(header.read_text())
    if name == "truncated chunk":
        chunk.write_bytes(content[: len(content) // 2])
    elif name == "missing chunk":
        chunk.unlink()
    elif name == "flipped bit":
        chunk.write_bytes(bytes([content[0] ^ 1]) + content[1:])
    elif name == "missing array":
        shutil.rmtree(folder / "draw")
    elif name == "garbled array metadata":
        (folder / "draw" / "zarr.json").write_text("{")
    elif name == "missing zarr.json":
        header.unlink()
    elif name == "garbled zarr.json":
        header.write_bytes(b"\x00\xff garbage")
    elif name == "changed attribute":
        attributes["attributes"]["mass_kg"] = 10.0
        header.write_text(json.dumps(attributes))
    elif name == "NaN attribute":
        attributes["attributes"]["mass_kg"] = float("nan")
        header.write_text(json.dumps(attributes))
    elif name == "newer version":
        attributes["attributes"]["schema_version"] = 99
        header.write_text(json.dumps(attributes))


@pytest.mark.parametrize("name", list(damages()))
def test_damage_is_named_in_one_line_and_other_recordings_stay_usable(store: RecordingStore, name: str) -> None:
    bad, good = store.write(a_recording()), store.write(a_recording(block=3))
    damage(name, store.path / bad)
    opened = RecordingStore(store.path)
    with pytest.raises(RecordingError) as refused:
        opened.read(bad)
    assert damages()[name] in str(refused.value)
    assert str(store.path / bad) in str(refused.value)
    assert "\n" not in str(refused.value)
    found = opened.validate()
    assert [one.id for one in found] == [bad]
    assert opened.read(good).block == 3
    with pytest.raises(RecordingError):
        opened.dataset([good, bad])


def test_the_remedy_for_damage_works(store: RecordingStore) -> None:
    recording_id = store.write(a_recording())
    damage("truncated chunk", store.path / recording_id)
    shutil.rmtree(store.path / recording_id)
    assert store.write(a_recording()) == recording_id
    assert store.validate() == []


def test_a_stray_file_in_a_store_is_reported(store: RecordingStore) -> None:
    (store.path / "notes.txt").write_text("mine")
    assert [one.id for one in store.validate()] == ["notes.txt"]


def test_a_path_that_is_no_store_is_refused_with_what_to_do(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="no recording store"):
        RecordingStore(tmp_path / "nothing.zarr")
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "letter.txt").write_text("dear")
    with pytest.raises(RecordingError, match="holds 'letter.txt' and no zarr.json.*Choose a new or empty folder"):
        RecordingStore(tmp_path / "mine", create=True)
    with pytest.raises(RecordingError, match="making the store failed"):
        RecordingStore(tmp_path / "mine" / "letter.txt" / "data.zarr", create=True)
    zarr.open_group(str(tmp_path / "other.zarr"), mode="w")
    with pytest.raises(RecordingError, match="zarr.json: damaged"):
        RecordingStore(tmp_path / "other.zarr")


def test_a_damaged_root_is_named_and_its_remedy_keeps_the_recordings(store: RecordingStore) -> None:
    recording_id = store.write(a_recording())
    (store.path / "zarr.json").write_text('{"zarr_format"')
    with pytest.raises(RecordingError, match="zarr.json: damaged.*delete the file"):
        RecordingStore(store.path)
    (store.path / "zarr.json").unlink()
    assert RecordingStore(store.path, create=True).ids() == (recording_id,)


def test_an_unknown_recording_is_named_with_the_closest(store: RecordingStore) -> None:
    recording_id = store.write(a_recording())
    wrong = recording_id[:-1] + ("0" if recording_id[-1] != "0" else "1")
    with pytest.raises(RecordingError, match=f"no recording '{wrong}' among 1. Did you mean '{recording_id}'"):
        store.read(wrong)


def test_a_folder_that_holds_a_store_is_told_where_it_lies(tmp_path: Path) -> None:
    """A run's folder given for its recordings: the one thing that is meant is in it."""
    RecordingStore(tmp_path / "data.zarr", create=True)
    with pytest.raises(RecordingError, match=r"no recording store.*There is one in it: .*data\.zarr\.$"):
        RecordingStore(tmp_path)
