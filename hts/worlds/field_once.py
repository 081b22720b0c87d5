"""One walk counts once: no two rows of a bundle hold the same samples, nor a row those of an earlier bundle.

A runner that calls every log 00.csv, or a folder that is copied as a whole, puts an old log where a new one is due.
What was read is known by a hash of each channel: of the bundles of this folder from a file beside them, of the run from
the attributes of its store. Neither reads a sample again: it costs half a millisecond for each recording stored, and a
second for each gigabyte of the bundle's own logs, which are in memory then.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from hts.atomic import atomic_write
from hts.errors import RecordingError
from hts.recordings.header import array_digest
from hts.recordings.recording import Recording
from hts.recordings.store import RecordingStore

READ = "read.json"
"""In the world's folder: bundle -> log, a path from there -> channel -> SHA-256 of its samples."""

Samples = Mapping[str, str]
"""SHA-256 of a channel's samples, by its name. Not of `time`: a log that is cut again begins at another stamp."""


def samples_of(recording: Recording) -> Samples:
    return {name: array_digest(np.asarray(series.values)) for name, series in recording.channels.items()}


def check_once(folder: Path, store: Path, bundle: Path, files: Sequence[Path], recordings: Sequence[Recording]) -> None:
    """Raise RecordingError if a row holds the samples of another row, or of a log of an earlier bundle.

    folder: of the world; store: the run's, which may not be there yet; files: the first one of each row's log. What was
    read is kept for the bundles to come; the same bundle may be read any number of times.
    """
    found = [samples_of(recording) for recording in recordings]
    _check_rows(files, found)
    known = _read(folder / READ)
    sessions = {recording.session for recording in recordings}
    earlier = [*_of_bundles(folder, known, bundle.name), *_of_store(store, sessions)]
    for file, samples in zip(files, found, strict=True):
        for place, others in earlier:
            if _same(samples, others):
                raise RecordingError(
                    f"{file}: the same samples as {place}, which this run has read already; no two walks are alike. "
                    "Put there the log of its own row, or record the row again."
                )
    names = [file.relative_to(folder).as_posix() for file in files]
    now = {**known, bundle.name: dict(zip(names, found, strict=True))}
    if now != known:
        atomic_write(folder / READ, json.dumps(now, indent=1) + "\n")


def _check_rows(files: Sequence[Path], found: Sequence[Samples]) -> None:
    seen: dict[tuple[tuple[str, str], ...], Path] = {}
    for file, samples in zip(files, found, strict=True):
        first = seen.setdefault(tuple(sorted(samples.items())), file)
        if first is not file:
            raise RecordingError(
                f"{file}: the same samples as {first.name}; no two walks are alike. Put there the log of its own "
                "row, or record the row again."
            )


def _same(one: Samples, other: Samples) -> bool:
    """Whether all channels that both have are equal: a mapping may have gained or lost one in between."""
    both = one.keys() & other.keys()
    return bool(both) and all(one[name] == other[name] for name in both)


def _read(path: Path) -> dict[str, dict[str, Samples]]:
    """What was read before; nothing where the file is damaged, or what it says of a bundle: it is a second look, and is
    written again."""
    try:
        known = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    known = known if isinstance(known, dict) else {}
    return {bundle: logs for bundle, logs in known.items() if _is_of_logs(logs)}


def _is_of_logs(found: object) -> bool:
    """Whether it is log -> channel -> hash."""
    return isinstance(found, dict) and all(isinstance(samples, dict) for samples in found.values())


def _of_bundles(folder: Path, known: Mapping[str, Mapping[str, Samples]], own: str) -> Iterator[tuple[str, Samples]]:
    """Of logs that still lie in other bundles: one that was moved from there was put right."""
    for bundle, logs in known.items():
        for name, samples in logs.items() if bundle != own else ():
            if (folder / name).exists():
                yield str(folder / name), samples


def _of_store(store: Path, sessions: set[str]) -> Iterator[tuple[str, Samples]]:
    """Of the run's recordings but for those of these sessions, which are this bundle's own, read before."""
    if not (store / "zarr.json").is_file():
        return
    opened = RecordingStore(store)
    for name in opened.ids():
        try:
            about = opened.attributes(name)
        except RecordingError:
            continue  # whoever uses it says so
        if about["session"] not in sessions:
            arrays = {channel: one["sha256"] for channel, one in about["arrays"].items() if channel != "time"}
            yield f"recording {name} of {store} ({about['role']}, session {about['session']})", arrays
