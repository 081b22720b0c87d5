"""Recordings as a LeRobot dataset, layout v3: each becomes an episode, each channel a feature.

    meta/info.json                                features, rate, counts
    meta/tasks.parquet                            one task for each policy that was recorded
    meta/stats.json                               mean, std, min, max, count of each feature
    meta/episodes/chunk-000/file-000.parquet      length of each episode and where it lies
    data/chunk-000/file-000.parquet               a row a time step

The layout is that of LeRobot 0.4 (`lerobot/datasets/utils.py`, codebase version v3.0).
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hts.atomic import atomic_write
from hts.errors import RecordingError, unknown_name
from hts.recordings.arrow import needs_pyarrow
from hts.recordings.partial import partial_folder, publish
from hts.recordings.recording import Recording

FILE = "chunk-000/file-000.parquet"
PATTERN = "chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
STATE, ACTION, OWN = "observation.state", "action", "observation."
COUNTERS = ("timestamp", "frame_index", "episode_index", "index", "task_index")


def write_dataset(
    recordings: Sequence[Recording], folder: Path, state: Sequence[str] = (), action: str | None = None
) -> None:
    """Write recordings of one robot and rate into a new folder.

    state: channels that become `observation.state`, one after the other; action: the channel that becomes `action`.
    Every channel is also a feature of its own, `observation.NAME`. Nothing is seen of the folder before all of it is
    there. Raises RecordingError for recordings that do not go together, a channel that is not in all, a rate that is no
    whole number, or a folder that exists.
    """
    needs_pyarrow(folder)
    if not recordings:
        raise RecordingError(f"{folder}: no recordings to export. Record or import some first.")
    if folder.exists():
        raise RecordingError(f"{folder}: exists already. Choose a new folder.")
    first = recordings[0]
    for one in recordings:
        _same(one, first)
    if first.rate_hz != round(first.rate_hz):
        raise RecordingError(
            f"{folder}: a dataset counts in whole frames a second, the recordings have {first.rate_hz:g} Hz."
        )
    features = _features(first, state, action)
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        with partial_folder(folder.parent) as made:
            _write(recordings, made, features, state, action)
            if not publish(made, folder):
                raise RecordingError(f"{folder}: exists already. Choose a new folder.")
    except OSError as error:
        raise RecordingError(
            f"{folder}: writing it failed ({error.strerror or error}). Free some space or choose another place."
        ) from error


def _same(one: Recording, first: Recording) -> None:
    for what in ("robot", "rate_hz", "joint_names"):
        if getattr(one, what) != getattr(first, what):
            raise RecordingError(
                f"Recording {one.id}: {what} is {getattr(one, what)}, of {first.id} {getattr(first, what)}. Export "
                "each kind by itself, by naming its recordings."
            )
    for name, series in first.channels.items():
        if name not in one.channels or one.channels[name].channel.shape != series.channel.shape:
            raise RecordingError(
                f"Recording {one.id}: no '{name}' of the shape that {first.id} has. Export them apart."
            )
    for name in one.channels:
        if name not in first.channels:
            raise RecordingError(f"Recording {first.id}: no '{name}', which {one.id} has. Export them apart.")


def _features(first: Recording, state: Sequence[str], action: str | None) -> dict[str, dict[str, Any]]:
    for name in (*state, *([action] if action else [])):
        if name not in first.channels:
            raise RecordingError(f"{first.id}: " + unknown_name("channel", name, first.channels))
    made: dict[str, dict[str, Any]] = {}
    if state:
        made[STATE] = _feature([entry for name in state for entry in _names(first, name, f"{name}.")])
    if action:
        made[ACTION] = _feature(_names(first, action))
    for name in first.channels:
        made[OWN + name] = {**_feature(_names(first, name)), "unit": first.channels[name].channel.unit}
    for name in COUNTERS:
        made[name] = {"dtype": "float32" if name == "timestamp" else "int64", "shape": [1], "names": None}
    return made


def _feature(names: list[str]) -> dict[str, Any]:
    return {"dtype": "float32", "shape": [len(names)], "names": names}


def _names(recording: Recording, name: str, prefix: str = "") -> list[str]:
    size = int(np.prod(recording.channels[name].channel.shape))
    if size == len(recording.joint_names):
        return [prefix + joint for joint in recording.joint_names]
    return [prefix.rstrip(".") or name] if size == 1 else [f"{prefix}{name}_{count}" for count in range(size)]


def _values(recording: Recording, feature: str, state: Sequence[str], action: str | None) -> np.ndarray:
    """(T, k) float32 of one feature."""
    names = state if feature == STATE else [action if feature == ACTION and action else feature.removeprefix(OWN)]
    count = recording.num_samples
    return np.concatenate([recording.values(name).reshape(count, -1) for name in names], axis=1)


def _write(
    recordings: Sequence[Recording],
    folder: Path,
    features: Mapping[str, dict[str, Any]],
    state: Sequence[str],
    action: str | None,
) -> None:
    import pyarrow as pa

    tasks = list(dict.fromkeys(_task(one) for one in recordings))
    data: dict[str, list[np.ndarray]] = {name: [] for name in features}
    episodes: list[dict[str, Any]] = []
    begin = 0
    for number, one in enumerate(recordings):
        count = one.num_samples
        frames = np.arange(count)
        task = tasks.index(_task(one))
        counters: dict[str, np.ndarray] = {
            "timestamp": (frames / one.rate_hz).astype(np.float32),
            "frame_index": frames,
        }
        counters |= {
            "episode_index": np.full(count, number),
            "index": begin + frames,
            "task_index": np.full(count, task),
        }
        for name, parts in data.items():
            parts.append(counters[name][:, None] if name in counters else _values(one, name, state, action))
        place = {
            "data/chunk_index": 0,
            "data/file_index": 0,
            "meta/episodes/chunk_index": 0,
            "meta/episodes/file_index": 0,
        }
        span = {"dataset_from_index": begin, "dataset_to_index": begin + count}
        episodes.append({"episode_index": number, "tasks": [tasks[task]], "length": count, **span, **place})
        begin += count
    whole = {name: np.concatenate(parts) for name, parts in data.items()}
    rows = pa.table({name: _column(values, features[name]) for name, values in whole.items()})
    table = pa.table({"task_index": pa.array(range(len(tasks)), pa.int64()), "task": pa.array(tasks)})
    _parquet(rows, folder / "data" / FILE)
    _parquet(pa.Table.from_pylist(episodes), folder / "meta" / "episodes" / FILE)
    _parquet(
        table.replace_schema_metadata({"pandas": json.dumps(_by_task(pa.__version__))}), folder / "meta/tasks.parquet"
    )
    first = recordings[0]
    info = {
        "codebase_version": "v3.0",
        "robot_type": first.robot,
        "total_episodes": len(recordings),
        "total_frames": begin,
        "total_tasks": len(tasks),
        "chunks_size": 1000,
        "data_files_size_in_mb": 100,
        "video_files_size_in_mb": 200,
        "fps": round(first.rate_hz),
        "splits": {"train": f"0:{len(recordings)}"},
        "data_path": f"data/{PATTERN}",
        "video_path": None,
        "features": dict(features),
    }
    atomic_write(folder / "meta/info.json", json.dumps(info, indent=4))
    atomic_write(folder / "meta/stats.json", json.dumps({name: _stats(values) for name, values in whole.items()}))


def _task(recording: Recording) -> str:
    """What was done, in a word: policies are what tells recordings apart."""
    policy = f" by policy {recording.policy_hash[:12]}" if recording.policy_hash else ""
    return f"{recording.role}{policy}"


def _column(values: np.ndarray, feature: Mapping[str, Any]) -> Any:
    import pyarrow as pa

    kind = pa.float32() if feature["dtype"] == "float32" else pa.int64()
    flat = pa.array(values.reshape(-1), kind)
    return flat if values.shape[1] == 1 else pa.FixedSizeListArray.from_arrays(flat, values.shape[1])


def _parquet(table: Any, file: Path) -> None:
    from pyarrow import parquet

    file.parent.mkdir(parents=True, exist_ok=True)
    parquet.write_table(table, file)


def _by_task(version: str) -> dict[str, Any]:
    """What pandas needs to read the task's text as the index of the table, as LeRobot expects it."""
    columns = [("task_index", "int64", "int64"), ("task", "unicode", "object")]
    return {
        "index_columns": ["task"],
        "column_indexes": [],
        "columns": [
            {"name": name, "field_name": name, "pandas_type": kind, "numpy_type": numpy, "metadata": None}
            for name, kind, numpy in columns
        ],
        "creator": {"library": "pyarrow", "version": version},
        "pandas_version": "2.0.0",
    }


def _stats(values: np.ndarray) -> dict[str, list[float]]:
    numbers = values.astype(np.float64)
    found = {"min": numbers.min(0), "max": numbers.max(0), "mean": numbers.mean(0), "std": numbers.std(0)}
    return {**{key: one.tolist() for key, one in found.items()}, "count": [len(values)]}
