"""Logs for the replay of an imported policy: a NumPy file, or recordings of a store."""

from __future__ import annotations

import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from hts.errors import ConfigError, PolicyError, unknown_name
from hts.yaml_text import load_mapping_file

LARGEST = 2**30  # bytes, unpacked
VECTORS = ("angular_velocity", "projected_gravity", "command")
JOINTS = ("joint_target", "joint_position", "joint_velocity", "joint_torque")
KEYS = ("time", "joint_names", "observation", "action", *JOINTS, *VECTORS)
"""What a NumPy file may hold, all optional: time (n,) s; joint_names (J,); observation (n, O), what the network was
given, before its normaliser; action (n, A), what it gave, without noise; targets and angles rad, speeds rad/s, torques
N·m, all (n, J) in the order of joint_names; angular_velocity rad/s, projected_gravity, command, each (n, 3)."""


@dataclass(frozen=True)
class Log:
    """Rows of one walk. Joint quantities in the order of joint_names; None: not logged."""

    path: Path
    time: np.ndarray | None = None
    joint_names: tuple[str, ...] = ()
    observation: np.ndarray | None = None
    action: np.ndarray | None = None
    joints: Mapping[str, np.ndarray] = field(default_factory=dict)
    vectors: Mapping[str, np.ndarray] = field(default_factory=dict)

    def by_joint(self, what: str, names: Sequence[str]) -> np.ndarray | None:
        """(n, J) in the order of names; None if not logged. Raises PolicyError for a joint that the log lacks."""
        if what not in self.joints:
            return None
        missing = [name for name in names if name not in self.joint_names]
        if missing:
            raise PolicyError(f"{self.path}: the log has no joint '{missing[0]}', only {list(self.joint_names)[:12]}.")
        return self.joints[what][:, [self.joint_names.index(name) for name in names]]


def read_log(path: Path, mapping: Path | None = None) -> Log:
    """The log in a .npz file, or in a store (a folder; its longest recording). mapping: a YAML file, our key -> the
    file's. Raises PolicyError for a file that is none, or arrays that do not fit together."""
    path = Path(path)
    if path.is_dir():
        if mapping is not None:
            raise ConfigError("--mapping is for the keys of a .npz file; a store's channels have their names.")
        return _of_store(path)
    if path.suffix != ".npz":
        raise PolicyError(
            f"{path}: logs are replayed from .npz files and from stores. Write one with numpy.savez, or bring the log "
            "into a store with `hts import`."
        )
    return _log_of(path, _arrays(path, _names(mapping)))


def _names(mapping: Path | None) -> dict[str, str]:
    if mapping is None:
        return {key: key for key in KEYS}
    given = load_mapping_file(mapping, "mapping of a log")
    for key, name in given.items():
        if key not in KEYS:
            raise ConfigError(f"{mapping}: " + unknown_name("key", key, KEYS))
        if not isinstance(name, str):
            raise ConfigError(f"{mapping}: {key}: expected the name of an array, found {str(name)[:60]}.")
    return {key: given.get(key, key) for key in KEYS}


def _arrays(path: Path, names: Mapping[str, str]) -> dict[str, np.ndarray]:
    try:
        with zipfile.ZipFile(path) as archive:
            if sum(entry.file_size for entry in archive.infolist()) > LARGEST:
                raise PolicyError(f"{path}: unpacks to more than {LARGEST >> 20} MB. Cut a minute out of it.")
        with np.load(path, allow_pickle=False) as opened:
            held = list(opened.files)
            return {key: opened[name] for key, name in names.items() if name in held}
    except (OSError, ValueError, EOFError, KeyError, zipfile.BadZipFile, NotImplementedError, RuntimeError) as error:
        why = (error.strerror if isinstance(error, OSError) else None) or str(error) or type(error).__name__
        raise PolicyError(f"{path}: not a whole .npz file of plain arrays ({' '.join(why.split())[:120]}).") from error


def _log_of(path: Path, arrays: Mapping[str, np.ndarray]) -> Log:
    names: tuple[str, ...] = ()
    if "joint_names" in arrays:
        if arrays["joint_names"].dtype.kind not in "US" or arrays["joint_names"].ndim != 1:
            raise PolicyError(f"{path}: joint_names holds {arrays['joint_names'].dtype}, expected text.")
        kept = arrays["joint_names"]
        names = tuple(str(name) for name in (np.char.decode(kept) if kept.dtype.kind == "S" else kept))
    found: dict[str, np.ndarray] = {}
    rows = None
    for key, values in arrays.items():
        if key == "joint_names":
            continue
        width = {**dict.fromkeys(VECTORS, 3), **dict.fromkeys(JOINTS, len(names))}.get(key)
        shape = values.shape
        if (
            values.dtype.kind not in "fiu"
            or values.ndim != (1 if key == "time" else 2)
            or (width and shape[1] != width)
        ):
            raise PolicyError(
                f"{path}: '{key}' has shape {shape} of {values.dtype}, expected numbers in the shape "
                f"{'(n,)' if key == 'time' else f'(n, {width or chr(107)})'}."
            )
        if rows not in (None, shape[0]):
            raise PolicyError(f"{path}: '{key}' has {shape[0]} rows, others {rows}.")
        rows = shape[0]
        if rows == 0:
            raise PolicyError(f"{path}: '{key}' has no rows. Replay a log of a minute, a row per control step.")
        found[key] = values.astype(np.float64)
        if not np.isfinite(found[key]).all():
            raise PolicyError(f"{path}: '{key}' holds numbers that are not finite. Cut these rows out.")
    if any(key in found for key in JOINTS) and (not names or len(set(names)) != len(names)):
        raise PolicyError(f"{path}: joint quantities need joint_names, each once, in the order of their columns.")
    if not found:
        raise PolicyError(f"{path}: holds none of {', '.join(KEYS)}. Name its arrays with --mapping.")
    time = found.get("time")
    if time is not None and (len(time) < 2 or not np.all(np.diff(time) > 0)):
        raise PolicyError(f"{path}: 'time' does not increase. Sort the rows, and leave out those that stand twice.")
    joints = {key: found[key] for key in JOINTS if key in found}
    vectors = {key: found[key] for key in VECTORS if key in found}
    return Log(path, time, names, found.get("observation"), found.get("action"), joints, vectors)


def _of_store(path: Path) -> Log:
    from hts.recordings.store import RecordingStore

    store = RecordingStore(path)
    ids = store.ids()
    if not ids:
        raise PolicyError(f"{path}: the store is empty.")
    recording = max((store.read(one) for one in ids), key=lambda one: one.num_samples)
    held = {name: series.values for name, series in recording.channels.items()}
    arrays = {key: held[key] for key in (*JOINTS, *VECTORS, "observation", "action") if key in held}
    return _log_of(path, {**arrays, "time": recording.time, "joint_names": np.array(recording.joint_names)})
