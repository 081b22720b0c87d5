"""A log read by somebody's reader: whatever goes wrong in its code is one line that names reader, package and file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pydantic import ValidationError

from hts.errors import HtsError, PluginError, RecordingError
from hts.explain import explain
from hts.recordings.checks import check
from hts.recordings.recording import Recording

if TYPE_CHECKING:
    from hts.contracts import Installed, LogReader, Robot

DEFAULT_READER = "csv"


def reader_name(mapping: Mapping[str, Any]) -> str:
    """The reader that a mapping asks for."""
    return str(mapping.get("reader", DEFAULT_READER))


def read_log(registry: Installed, files: Sequence[Path], mapping: Mapping[str, Any], robot: Robot) -> Recording:
    """One recording from the files, which hold one run; otherwise as `read_logs`."""
    recordings = read_logs(registry, files, mapping, robot)
    if len(recordings) != 1:
        where = ", ".join(str(file) for file in files)
        raise RecordingError(f"{where}: {len(recordings)} runs, expected one. Take one by `runs` or `labels`.")
    return recordings[0]


def read_logs(
    registry: Installed, files: Sequence[Path], mapping: Mapping[str, Any], robot: Robot
) -> Sequence[Recording]:
    """A recording for each run in the files, by the reader that the mapping names, fit to be stored.

    Raises the reader's own HtsError; PluginError where it fails in another way or gives no recording; RecordingError
    for a recording that a store refuses, or whose channels are not those of the robot.
    """
    name = reader_name(mapping)
    where = ", ".join(str(file) for file in files)
    for file in files:
        if file.exists() and not (file.is_file() or file.is_dir()):  # a reader would wait for it for ever
            raise RecordingError(f"{file}: a pipe or a device, expected a file. Write the log to a file first.")
    reader = registry.make_log_reader(name)
    try:
        recordings = list(reader.read_all(files, mapping, robot))
    except HtsError:
        raise
    except ValidationError as error:
        raise PluginError(f"{_who(reader, name, where)}: {error.title}: {explain(error)}") from error
    except Exception as error:
        text = " ".join(str(error).split())
        raise PluginError(
            f"{_who(reader, name, where)} failed, {type(error).__name__}: {text} (HTS_DEBUG=1 shows where)."
        ) from error
    for recording in recordings:
        if not isinstance(recording, Recording):
            found = type(recording).__name__
            raise PluginError(
                f"{_who(reader, name, where)} gives a {found}, expected a hts.recordings.recording.Recording."
            )
        check(recording, where)
        _check_robot(recording, robot, where)
    return recordings


def _who(reader: LogReader, name: str, where: str) -> str:
    return f"{where}: log reader '{name}' (of {type(reader).__module__})"


def _check_robot(recording: Recording, robot: Robot, where: str) -> None:
    """Channels that the robot has are as it has them; a model fitted to them could not be used in its simulation."""
    own = robot.channels()
    for name, series in recording.channels.items():
        if name not in own:
            continue
        found, wanted = series.channel, own[name]
        if (found.unit, tuple(found.shape)) != (wanted.unit, tuple(wanted.shape)):
            raise RecordingError(
                f"{where}: '{name}' is {found.unit} {tuple(found.shape)} a sample, robot '{robot.spec.name}' has it in "
                f"{wanted.unit} {tuple(wanted.shape)}. Correct the reader or its mapping."
            )
