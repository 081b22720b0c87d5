"""`data.zarr`: one immutable Zarr 3 group per recording, all of it there or none of it.

    data.zarr/zarr.json             the store itself
    data.zarr/<id>/zarr.json        attributes of one recording (see header.py)
    data.zarr/<id>/time, <channel>  arrays float64 (T,) and float32 (T, *shape), each with its unit and rate
    data.zarr/.partial-…            somebody is writing, or was killed while doing so

Arrays are uncompressed and mostly one chunk: sensor noise does not compress (8 % at zstd level 1), and a run
reads all its recordings for every fit. Any Zarr 3 reader opens the store.
"""

from __future__ import annotations

import errno
import json
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from hts.cores import available
from hts.errors import RecordingError, unknown_name
from hts.near import nearest
from hts.recordings import partial
from hts.recordings.arrays import read_array, write_group
from hts.recordings.checks import check
from hts.recordings.header import (
    ID_PATTERN,
    SCHEMA_VERSION,
    array_checksum,
    array_digest,
    content_id,
    dataset_digest,
    fault_of,
    from_attributes,
    to_attributes,
)
from hts.recordings.recording import Recording

KIND = "hts recordings"


@dataclass(frozen=True)
class Dataset:
    """The recordings a model was trained on: sorted ids, and the SHA-256 of their decoded arrays."""

    ids: tuple[str, ...]
    sha256: str


@dataclass(frozen=True)
class Damage:
    """One recording (or stray file) that cannot be trusted, and why, in one line."""

    id: str
    message: str


class RecordingStore:
    """Recordings in a folder. Reading changes nothing on disk; several processes may read and write at once.

    path: the `.zarr` folder; create: make it if it is not there, and remove what killed writers left.
    Raises RecordingError if there is no store at `path`, or it cannot be made.
    """

    def __init__(self, path: Path | str, create: bool = False) -> None:
        self.path = Path(path)
        self._writing = create
        if create:
            self._create()
        self._check_root()

    # ------------------------------------------------------------------------------------------ reading

    def ids(self) -> tuple[str, ...]:
        """All recordings, sorted by id, including damaged ones. Their order says nothing about time."""
        try:
            names = [entry.name for entry in self.path.iterdir() if entry.is_dir()]
        except OSError as error:
            self._refuse(error, "listing the recordings")
        return tuple(sorted(name for name in names if ID_PATTERN.fullmatch(name)))

    def attributes(self, recording_id: str) -> dict[str, Any]:
        """Everything about a recording but its samples. Raises RecordingError if it is unknown or damaged."""
        file = self._folder(recording_id) / "zarr.json"
        remedy = f"Delete the folder {file.parent} and collect or import this recording again."
        try:
            attributes = _read_attributes(file, remedy)
        except FileNotFoundError:
            raise RecordingError(f"{file}: missing. Expected the attributes of the recording. {remedy}") from None
        except OSError as error:
            self._refuse(error, f"reading {file}")
        try:
            genuine = content_id(attributes) == recording_id
        except ValueError:  # NaN, which Python reads from JSON but nobody stored
            genuine = False
        if not genuine:
            raise RecordingError(
                f"{file}: damaged: the attributes are not those that {recording_id} was named for. {remedy}"
            )
        fault = fault_of(attributes)
        if fault is not None:
            raise RecordingError(f"{file}: holds {fault}. {remedy}")
        return attributes

    def read(self, recording_id: str, channels: Iterable[str] | None = None) -> Recording:
        """A recording with all channels, or only those named. Every array read is compared with its checksum.

        Raises RecordingError naming the damaged file, or an unknown recording or channel.
        """
        attributes = self.attributes(recording_id)
        known = [name for name in attributes["arrays"] if name != "time"]
        wanted = known if channels is None else list(channels)
        for name in wanted:
            if name not in known:
                raise RecordingError(f"{self._folder(recording_id)}: " + unknown_name("channel", name, known))
        values = {name: self._array(recording_id, attributes, name) for name in wanted}
        time = self._array(recording_id, attributes, "time")
        try:
            return from_attributes(attributes, time, values, recording_id)
        except (KeyError, TypeError, ValueError) as error:  # attributes that fit their id, and say too little
            what = f"{type(error).__name__}: {error}".splitlines()[0]
            raise RecordingError(
                f"{self._folder(recording_id) / 'zarr.json'}: not the attributes of a recording ({what})."
            ) from error

    def dataset(self, ids: Iterable[str]) -> Dataset:
        """Name a set of recordings by ids and the SHA-256 of their decoded arrays; order and repeats do not matter.

        Reads every array, so a damaged recording cannot get into a dataset: raises RecordingError naming it.
        """
        wanted = sorted(set(ids))
        # Hashing is most of it, and Python lets go of its lock meanwhile. `map` keeps the order, also of errors.
        with ThreadPoolExecutor(available()) as pool:
            members = dict(zip(wanted, pool.map(self._proven, wanted), strict=True))
        return Dataset(tuple(members), dataset_digest(members))

    def validate(self) -> list[Damage]:
        """Read and hash everything; one entry per damaged recording or stray file, none if all is well."""
        damages = []
        for recording_id in self.ids():
            try:
                self.dataset([recording_id])
            except RecordingError as error:
                damages.append(Damage(recording_id, str(error)))
        for entry in sorted(self.path.iterdir()):
            known = entry.name == "zarr.json" or (entry.is_dir() and ID_PATTERN.fullmatch(entry.name))
            if not known and not entry.name.startswith("."):
                damages.append(Damage(entry.name, f"{entry}: not a recording. Move it out of the store."))
        return damages

    # ------------------------------------------------------------------------------------------ writing

    def write(self, recording: Recording, where: str = "Recording") -> str:
        """Check and store a recording; returns its id. Writing it again is harmless and returns the same id.

        Nothing becomes visible before all of it is on the disk. Raises RecordingError if the recording is refused
        (see checks.py) or the disk is full or read-only; `where` begins the message, such as the log's path.
        """
        check(recording, where)
        attributes = to_attributes(recording)
        try:
            recording_id = content_id(attributes)
        except (TypeError, ValueError) as error:
            raise RecordingError(
                f"{where}: the schedule or notes cannot be stored ({error}). Use finite numbers and text."
            ) from error
        final = self.path / recording_id
        try:
            if not self._writing:
                self._writing = True
                partial.clean(self.path)
            if final.exists():
                return recording_id
            arrays = {"time": recording.time, **{name: series.values for name, series in recording.channels.items()}}
            with partial.partial_folder(self.path) as folder:
                write_group(folder, attributes, arrays)
                partial.publish(folder, final)
        except OSError as error:
            self._refuse(error, "writing a recording")
        return recording_id

    # ----------------------------------------------------------------------------------------- internal

    def _create(self) -> None:
        try:
            self.path.mkdir(parents=True, exist_ok=True)
            partial.clean(self.path)
            if (self.path / "zarr.json").exists():
                return
            for entry in self.path.iterdir():
                if not ID_PATTERN.fullmatch(entry.name) and not entry.name.startswith("."):
                    raise RecordingError(
                        f"{self.path}: holds '{entry.name}' and no zarr.json, so it is not a recording store. "
                        "Choose a new or empty folder."
                    )
            root = {
                "zarr_format": 3,
                "node_type": "group",
                "attributes": {"kind": KIND, "schema_version": SCHEMA_VERSION},
            }
            partial.publish_file(json.dumps(root, indent=2), self.path / "zarr.json")
        except OSError as error:
            self._refuse(error, "making the store")

    def _check_root(self) -> None:
        file = self.path / "zarr.json"
        remedy = (
            "If this is a store, delete the file: the next writing command makes it anew. If not, correct the path."
        )
        try:
            kind = _read_attributes(file, remedy).get("kind")
        except (FileNotFoundError, NotADirectoryError):
            within = sorted(one.parent for one in self.path.glob("*.zarr/zarr.json"))  # as in a run's folder
            meant = f"There is one in it: {within[0]}." if within else "`hts import` makes a new one."
            raise RecordingError(f"{self.path}: no recording store (no zarr.json). Correct the path. {meant}") from None
        except OSError as error:
            self._refuse(error, f"reading {file}")
        if kind != KIND:
            raise RecordingError(f"{file}: its kind is {kind!r}, expected '{KIND}'. {remedy}")

    def _folder(self, recording_id: str) -> Path:
        folder = self.path / recording_id
        if not ID_PATTERN.fullmatch(recording_id) or not folder.is_dir():
            close = nearest(recording_id, self.ids())
            hint = f" Did you mean '{close}'?" if close is not None else ""
            raise RecordingError(
                f"{self.path}: no recording '{recording_id}' among {len(self.ids())}.{hint} `hts data ls` lists them."
            )
        return folder

    def _proven(self, recording_id: str) -> dict[str, str]:
        """The hash of each array of a recording, every one compared with what is on the disk."""
        attributes = self.attributes(recording_id)
        for name in attributes["arrays"]:
            self._array(recording_id, attributes, name, proof=True)
        return {name: about["sha256"] for name, about in attributes["arrays"].items()}

    def _array(self, recording_id: str, attributes: dict[str, Any], name: str, proof: bool = False) -> np.ndarray:
        """One array, compared with the checksum (or, as proof, the hash) in the already verified attributes."""
        folder = self.path / recording_id / name
        about = attributes["arrays"][name]
        remedy = f"Delete the folder {folder.parent} and collect or import this recording again."
        shape = (attributes["samples"], *about["shape"])
        try:
            values = read_array(folder, shape)
        # Whatever the array's metadata and codecs trip over, to the user it is one thing: a damaged array.
        except Exception as error:
            what = f"{type(error).__name__}: {error}".splitlines()[0]
            raise RecordingError(f"{folder}: damaged ({what}). Expected samples of shape {shape}. {remedy}") from error
        found, expected = (array_digest(values), about["sha256"]) if proof else (array_checksum(values), about["crc32"])
        if found != expected:
            raise RecordingError(
                f"{folder}: damaged: its samples hash to {found[:8]}, expected {expected[:8]}. {remedy}"
            )
        return values

    def _refuse(self, error: OSError, doing: str) -> NoReturn:
        """Raise what the operating system says as one line with a remedy."""
        remedies = {
            errno.ENOSPC: "The disk is full: free some space",
            errno.EDQUOT: "The disk quota is used up: free some space",
            errno.EROFS: "The file system is read-only: choose another place",
            errno.EACCES: "Access is denied: correct the permissions or choose another place",
            errno.EPERM: "Access is denied: correct the permissions or choose another place",
        }
        remedy = remedies.get(error.errno or 0, "Check the disk and the path")
        kept = " Nothing is half-written; give the command again afterwards." if self._writing else ""
        raise RecordingError(f"{self.path}: {doing} failed ({error.strerror or error}). {remedy}.{kept}") from error


def _read_attributes(file: Path, remedy: str) -> dict[str, Any]:
    """Attributes in the zarr.json of a group. Raises OSError, or RecordingError if they are not ours to read."""
    try:
        attributes = json.loads(file.read_bytes())["attributes"]
        version = attributes["schema_version"]
    except (ValueError, KeyError, TypeError) as error:
        what = f"{type(error).__name__}: {error}"
        raise RecordingError(
            f"{file}: damaged ({what}). Expected JSON with a recording's attributes. {remedy}"
        ) from error
    if version != SCHEMA_VERSION:
        raise RecordingError(
            f"{file}: schema version {version!r}, this hts reads {SCHEMA_VERSION}. Install the hts that wrote it."
        )
    return attributes
