"""LeRobot datasets, layout v3, in and out."""

from __future__ import annotations

import json
import shutil

import numpy as np
import pytest

from hts.errors import RecordingError
from hts.recordings.lerobot_reader import make, names_of
from hts.recordings.lerobot_writer import write_dataset
from hts.recordings.logs import recording_from_columns

STEPS = np.arange(60)


@pytest.fixture
def recorded(tmp_path, mapping, two_joints):
    def one(offset: float, policy: str):
        columns = {"t": 20 * STEPS, "H_tau": STEPS / 10, "K_tau": -STEPS / 10, "amps": offset + STEPS / 100}
        given = {**mapping, "recording": {"policy_hash": policy}}
        return recording_from_columns([tmp_path / policy], given, two_joints, lambda path: columns).replace(id=policy)

    return [one(2.0, "f00"), one(3.0, "ba2")]


@pytest.fixture
def dataset(tmp_path, recorded):
    folder = tmp_path / "set"
    write_dataset(recorded, folder, state=["joint_torque"], action="joint_torque")
    return folder


@pytest.fixture
def set_mapping():
    return {
        "reader": "lerobot",
        "rate_hz": 50,
        "joints": {"hip": "hip", "knee": "knee"},
        "channels": {
            "joint_torque": {"columns": "observation.joint_torque[{joint}]", "unit": "N*m"},
            "draw": {"columns": "observation.draw", "unit": "A", "idle": 1.9},
        },
    }


def test_what_was_exported_is_read_back_episode_by_episode(dataset, set_mapping, recorded, two_joints):
    found = make({}).read_all([dataset], set_mapping, two_joints)
    assert len(found) == 2
    for one, was in zip(found, recorded, strict=True):
        for name in ("joint_torque", "draw"):
            np.testing.assert_allclose(one.values(name), was.values(name), atol=1e-5)
    assert [one.notes["run_episode_index"] for one in found] == ["0", "1"]
    set_mapping["runs"] = {"column": "episode_index", "take": [1]}
    assert make({}).read([dataset], set_mapping, two_joints).values("draw")[0] == pytest.approx(3.0, abs=1e-5)


def test_the_layout_is_that_of_version_3(dataset):
    from pyarrow import parquet

    info = json.loads((dataset / "meta/info.json").read_text())
    assert (info["codebase_version"], info["fps"], info["total_episodes"], info["total_frames"]) == ("v3.0", 50, 2, 120)
    assert info["data_path"] == "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
    state = info["features"]["observation.state"]
    assert state["names"] == ["joint_torque.hip", "joint_torque.knee"] and state["shape"] == [2]
    rows = parquet.read_table(dataset / "data/chunk-000/file-000.parquet").to_pydict()
    assert set(rows) == set(info["features"])
    assert rows["index"] == list(range(120)) and rows["frame_index"] == 2 * list(range(60))
    np.testing.assert_allclose(rows["timestamp"][60:62], [0.0, 0.02])
    episodes = parquet.read_table(dataset / "meta/episodes/chunk-000/file-000.parquet").to_pylist()
    assert [(one["dataset_from_index"], one["dataset_to_index"]) for one in episodes] == [(0, 60), (60, 120)]
    tasks = parquet.read_table(dataset / "meta/tasks.parquet")
    assert tasks.to_pydict() == {"task_index": [0, 1], "task": ["collection by policy f00", "collection by policy ba2"]}
    assert json.loads(tasks.schema.metadata[b"pandas"])["index_columns"] == ["task"]
    stats = json.loads((dataset / "meta/stats.json").read_text())
    assert stats["observation.draw"]["min"] == [2.0] and stats["observation.draw"]["count"] == [120]


def test_a_set_of_several_files_is_one(dataset, set_mapping, two_joints):
    """LeRobot begins a file where one has grown too large."""
    from pyarrow import parquet

    data = dataset / "data/chunk-000"
    table = parquet.read_table(data / "file-000.parquet")
    parquet.write_table(table.slice(0, 60), data / "file-000.parquet")
    parquet.write_table(table.slice(60), data / "file-001.parquet")
    assert [one.num_samples for one in make({}).read_all([dataset], set_mapping, two_joints)] == [60, 60]


@pytest.mark.parametrize(
    ("names", "expected"),
    [(["a", "b"], ["a", "b"]), ({"motors": ["a", "b"]}, ["a", "b"]), ({"b": 0, "a": 1}, ["b", "a"]), (None, [])],
)
def test_names_are_understood_however_they_are_written(names, expected):
    assert names_of({"names": names}) == expected


def damaged(folder, kind):
    info = folder / "meta/info.json"
    if kind == "older":
        info.write_text(json.dumps({**json.loads(info.read_text()), "codebase_version": "v2.1"}))
    elif kind == "no json":
        info.write_text("{")
    elif kind == "no info":
        info.unlink()
    elif kind == "no data":
        shutil.rmtree(folder / "data")
    elif kind == "no features":
        info.write_text('{"codebase_version": "v3.0", "features": [], "fps": 50}')
    else:
        (folder / "data/chunk-000/file-000.parquet").write_bytes(b"PAR1")


def test_a_set_of_which_a_file_is_missing_is_not_taken_for_the_whole(dataset, set_mapping, two_joints):
    """As where not all of it was downloaded; episodes that are whole may be named."""
    info = json.loads((dataset / "meta/info.json").read_text())
    (dataset / "meta/info.json").write_text(json.dumps({**info, "total_frames": 180}))
    with pytest.raises(RecordingError, match="120 frames in data/, meta/info.json says 180: files are missing"):
        make({}).read_all([dataset], set_mapping, two_joints)
    set_mapping["runs"] = {"column": "episode_index", "take": [1]}
    assert len(make({}).read_all([dataset], set_mapping, two_joints)) == 1


@pytest.mark.parametrize(
    ("kind", "expected"),
    [
        ("older", "layout 'v2.1', expected v3"),
        ("no json", "info.json: not JSON"),
        ("no info", "no LeRobot dataset, meta/info.json cannot be read"),
        ("no data", "no data/chunk-.*parquet in this dataset"),
        ("no features", "no `features` or no `fps`"),
        ("no parquet", "not a whole Parquet file"),
    ],
)
def test_a_damaged_set_is_one_line(dataset, set_mapping, two_joints, kind, expected):
    damaged(dataset, kind)
    with pytest.raises(RecordingError, match=expected) as refused:
        make({}).read_all([dataset], set_mapping, two_joints)
    assert "\n" not in str(refused.value)


def test_a_feature_or_entry_that_is_not_there_is_named(dataset, set_mapping, two_joints):
    set_mapping["joints"]["hip"] = "hop"
    with pytest.raises(
        RecordingError, match=r"feature 'observation.joint_torque': No entry named 'hop'. Did you mean 'hip'"
    ):
        make({}).read_all([dataset], set_mapping, two_joints)
    set_mapping["channels"] = {"draw": {"columns": "observation.drow", "unit": "A", "idle": 1.9}}
    with pytest.raises(RecordingError, match=r"No feature named 'observation.drow'. Did you mean 'observation.draw'"):
        make({}).read_all([dataset], set_mapping, two_joints)


def test_recordings_that_do_not_go_together_are_not_exported(tmp_path, recorded):
    first, second = recorded
    for other, expected in (
        (second.replace(rate_hz=25.0), "rate_hz is 25.0"),
        (second.replace(channels={"draw": second.channels["draw"]}), "no 'joint_torque' of the shape"),
    ):
        with pytest.raises(RecordingError, match=expected):
            write_dataset([first, other], tmp_path / "new")
    with pytest.raises(RecordingError, match="No channel named 'drow'"):
        write_dataset([first], tmp_path / "new", state=["drow"])
    with pytest.raises(RecordingError, match="exists already"):
        write_dataset([first], tmp_path)
    assert not (tmp_path / "new").exists() and not list(tmp_path.glob(".partial*"))
