"""LeRobot datasets, layout v3: a folder of Parquet files in which episodes follow each other; each is a recording.

Read as what they are, Parquet and JSON: the package itself asks for another torch than ours. Entries of a feature are
written by number, `observation.state[3]`, or by the name that the dataset gives them, `observation.state[elbow.pos]`.
Films and images are not read.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from pydantic import Field

from hts.errors import RecordingError, unknown_name
from hts.recordings.logs import LogMapping, Table
from hts.recordings.mapping import TimeMapping
from hts.recordings.mapping_parts import RunsMapping
from hts.recordings.parquet_reader import read_table as read_parquet
from hts.recordings.table import ColumnName
from hts.recordings.table_reader import TableReader

if TYPE_CHECKING:
    from hts.contracts import LogReader, Settings

VERSION = "v3"
MOST_INFO = 1 << 24
MOST_NUMBERS = 1 << 28
NEARLY_A_FRAME = 0.02
"""Periods by which a float32 stamp may miss its frame."""


class LerobotMapping(LogMapping):
    """A mapping whose columns are features; what the layout fixes has it as default."""

    time: TimeMapping = Field(
        TimeMapping(column="timestamp", unit="s"), description="the column of time stamps, s after an episode's begin"
    )
    runs: RunsMapping | None = Field(
        RunsMapping(column="episode_index"), description="how episodes are told apart; `take` names some of them"
    )


def make(settings: Settings) -> LogReader:
    """Factory of the log reader `lerobot`."""
    return TableReader(settings, read_table, LerobotMapping)


def read_table(path: Path, wanted: Sequence[ColumnName], log: LerobotMapping) -> Table:
    """Stamps and wanted features of all episodes. Raises RecordingError naming folder and feature."""
    info = read_info(path)
    plain = {column: _numbered(path, str(column), info["features"]) for column in wanted}
    tables: list[Table] = []
    for file in data_files(path):
        tables.append(read_parquet(file, tuple(plain.values()), log))
        if sum(len(table.stamps) for table in tables) * (len(wanted) + 1) > MOST_NUMBERS:
            raise RecordingError(
                f"{path}: more than {MOST_NUMBERS:.3g} numbers. Split the dataset, or name less channels."
            )
    frames, expected = sum(len(table.stamps) + table.empty_rows for table in tables), info.get("total_frames")
    if isinstance(expected, int) and frames < expected and (log.runs is None or log.runs.take is None):
        raise RecordingError(
            f"{path}: {frames} frames in data/, meta/info.json says {expected}: files are missing. Copy the whole "
            "folder, or name the episodes that are there whole, such as runs: {column: episode_index, take: [0]}."
        )
    columns = {column: np.concatenate([table.columns[name] for table in tables]) for column, name in plain.items()}
    stamps = np.concatenate([np.asarray(table.stamps, dtype=np.float64) for table in tables])
    if log.time == LerobotMapping.model_fields["time"].default:
        stamps = _whole_frames(stamps, float(info["fps"]))
    return Table(path, stamps, columns, sum(table.empty_rows for table in tables))


def _whole_frames(stamps: np.ndarray, rate_hz: float) -> np.ndarray:
    """Seconds of whole frames, where stamps are those but for being float32; others as they are."""
    frames = np.round(stamps * rate_hz)
    return frames / rate_hz if np.all(np.abs(stamps * rate_hz - frames) < NEARLY_A_FRAME) else stamps


def data_files(path: Path) -> list[Path]:
    """The Parquet files of a dataset, in order. Raises RecordingError where there is none."""
    files = sorted((path / "data").glob("chunk-*/file-*.parquet"))
    if not files:
        raise RecordingError(f"{path}: no data/chunk-*/file-*.parquet in this dataset. Copy the whole folder.")
    return files


def read_info(path: Path) -> dict[str, Any]:
    """meta/info.json of a dataset. Raises RecordingError for a folder that is none, or is of another layout."""
    file = path / "meta" / "info.json"
    try:
        if file.stat().st_size > MOST_INFO:
            raise RecordingError(
                f"{file}: {file.stat().st_size} bytes, at most {MOST_INFO} are read. It is no such file."
            )
        info = json.loads(file.read_bytes())
    except OSError as error:
        raise RecordingError(
            f"{path}: no LeRobot dataset, meta/info.json cannot be read ({error.strerror or error}). Name its folder."
        ) from error
    except (ValueError, RecursionError) as error:
        raise RecordingError(f"{file}: not JSON ({' '.join(str(error).split()):.120}). Copy it again.") from error
    version = str(info.get("codebase_version", "")) if isinstance(info, dict) else ""
    if not version.startswith(VERSION):
        raise RecordingError(
            f"{file}: layout '{version:.20}', expected {VERSION}. Convert it by LeRobot's own script "
            "(lerobot.datasets.v30.convert_dataset_v21_to_v30)."
        )
    if not isinstance(info.get("features"), dict) or not isinstance(info.get("fps"), (int, float)):
        raise RecordingError(f"{file}: no `features` or no `fps`. Copy it again.")
    return dict(info)


def names_of(feature: Any) -> list[str]:
    """The names of a feature's entries, however a dataset writes them; none if it has none."""
    names = feature.get("names") if isinstance(feature, dict) else None
    if isinstance(names, dict):
        lists = [one for one in names.values() if isinstance(one, list)]
        names = lists[0] if len(lists) == 1 else [key for key, _ in sorted(names.items(), key=lambda one: str(one[1]))]
    return [str(name) for name in names] if isinstance(names, list) else []


def _numbered(path: Path, column: str, features: Mapping[str, Any]) -> str:
    """The column as the Parquet files know it: features of one number are columns, the others lists."""
    found = re.fullmatch(r"(.+?)\[(.+)\]", column)
    name = found[1] if found else column
    if name not in features:
        raise RecordingError(f"{path}: " + unknown_name("feature", name, features))
    if found is None or str(found[2]).isdecimal():
        return column
    names = names_of(features[name])
    if found[2] not in names:
        raise RecordingError(f"{path}: feature '{name}': " + unknown_name("entry", found[2], names))
    return f"{name}[{names.index(found[2])}]"
