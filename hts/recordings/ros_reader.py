"""ROS 2 bags and MCAP files without ROS: a mapping says which field of which topic is which channel.

Fields are written as in the message: `motor_state[3].q`, `wrench.force.x`; `position[left_knee]` is the entry whose
name stands at the same place of the message's own `name`, as in a JointState.
"""

from __future__ import annotations

import re
from array import array
from collections.abc import Callable, Sequence
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from pydantic import Field

from hts.errors import ConfigError, RecordingError
from hts.recordings.logs import LogMapping, Table, table_of
from hts.recordings.mapping import SECONDS
from hts.recordings.messages import Message, fields_of, messages, no_topic
from hts.recordings.table import ColumnName
from hts.recordings.table_reader import TableReader

if TYPE_CHECKING:
    from hts.contracts import LogReader, Settings

LOG_TIME, PUBLISH_TIME = "log_time", "publish_time"
SEPARATOR = re.compile(r"^=+\s*$", re.MULTILINE)
MOST_TEXT = 1 << 20
MOST_NUMBERS = 1 << 28


class RosMapping(LogMapping):
    """A mapping whose columns are fields of messages; `time.column` may be log_time or publish_time, both in ns."""

    topic: str | None = Field(None, description="of all channels that name none of their own")
    definitions: str | None = Field(
        None,
        description="text file of message definitions, where the bag holds none; PACKAGE:FILE of an installed package",
    )


def make(settings: Settings) -> LogReader:
    """Factory of the log reader `ros`."""
    return TableReader(settings, read_table, RosMapping)


def read_table(path: Path, wanted: Sequence[ColumnName], log: RosMapping) -> Table:
    """The stamps and wanted fields of one topic's messages. Raises RecordingError naming file, topic and field."""
    if log.topic is None:
        raise ConfigError("Mapping: say `topic`: of the whole mapping, or of each channel.")
    time, topic = log.time.column, log.topic
    getters = {column: _getter(str(column)) for column in wanted}
    stamp = _stamp(str(time))
    stamps: list[int | float] = []
    received = array("d")
    values = {column: array("d") for column in wanted}
    for count, message in enumerate(messages(path, topic, load_definitions(log.definitions))):
        if count * (len(wanted) + 1) > MOST_NUMBERS:
            raise RecordingError(f"{path}: topic '{topic}' has more than {count} messages. Cut the bag first.")
        try:
            stamps.append(stamp(message))
            received.append(message.log_time * SECONDS["ns"])
            for column, get in getters.items():
                values[column].append(float(get(message.content)))
        except (LookupError, TypeError, ValueError, OverflowError) as error:
            what = " ".join(str(error).split())
            raise RecordingError(
                f"{path}: message {count + 1} of '{topic}' does not give what the mapping asks for: {what:.160}. It "
                f"has {', '.join(fields_of(message.content)[:40]) or 'no fields'}."
            ) from error
    if not stamps:
        raise no_topic(path, topic)
    columns: dict[ColumnName, Any] = {column: np.array(numbers) for column, numbers in values.items()}
    table = table_of(
        path, time, log.time.unit, wanted, {**columns, time: np.array(stamps)}, log.runs.column if log.runs else None
    )
    after = np.array(received) - np.array(stamps, dtype=np.float64) * SECONDS[log.time.unit]
    return replace(table, received_after=float(np.nanmedian(after)))


def load_definitions(name: str | None) -> dict[str, str]:
    """Message type -> text, from a file that holds several as ROS writes them: `MSG: package/Type` after a line of `=`.

    Raises ConfigError for a file that cannot be read or holds none.
    """
    if name is None:
        return {}
    path = _definitions_file(name)
    try:
        if path.stat().st_size > MOST_TEXT:
            raise ConfigError(f"{path}: definitions of more than {MOST_TEXT} bytes. Keep those that are needed.")
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = (error.strerror if isinstance(error, OSError) else None) or str(error)
        raise ConfigError(f"{path}: cannot read these definitions ({reason}).") from error
    parts = [part.strip().partition("\n") for part in SEPARATOR.split(text)]
    named = {first.removeprefix("MSG:").strip(): rest for first, _, rest in parts if first.startswith("MSG:")}
    if not named:
        raise ConfigError(
            f"{path}: no message definition. Begin each with a line of = and one such as MSG: package/Type."
        )
    found = {}
    for kind, body in named.items():
        others = [f"{'=' * 80}\nMSG: {other}\n{rest}" for other, rest in named.items() if other != kind]
        package, _, short = kind.partition("/")
        found[f"{package}/msg/{short.removeprefix('msg/')}"] = "\n".join([body, *others])
    return found


def _definitions_file(name: str) -> Path:
    package, colon, file = name.partition(":")
    if not colon:
        return Path(name)
    if not package.isidentifier() or ".." in Path(file).parts or Path(file).is_absolute():
        raise ConfigError(f"Mapping: definitions: '{name:.80}' is no file, and no PACKAGE:FILE.")
    found = find_spec(package)  # looked up, not imported
    if found is None or not found.submodule_search_locations:
        raise ConfigError(f"Mapping: definitions: no package '{package}' is installed. Install it, or name a file.")
    return Path(found.submodule_search_locations[0]) / file


def _stamp(column: str) -> Callable[[Message], int | float]:
    if column == LOG_TIME:
        return lambda message: message.log_time
    if column == PUBLISH_TIME:
        return lambda message: message.publish_time
    get = _getter(column)

    def read(message: Message) -> int | float:
        value = get(message.content)
        if {"sec", "nanosec"} <= set(fields_of(value)):  # a ROS time is whole nanoseconds
            return int(value.sec) * 1_000_000_000 + int(value.nanosec)
        return value

    return read


def _getter(column: str) -> Callable[[Any], Any]:
    """What finds a field in a message. Raises ConfigError for what is no field."""
    steps: list[str | int] = []
    for part in column.split("."):
        found = re.fullmatch(r"([A-Za-z]\w*)(?:\[([^\[\]]{1,100})\])?", part)
        if found is None:
            raise ConfigError(f"Mapping: '{column:.80}' is no field of a message, such as motor_state[3].q or force.x.")
        steps.append(found[1])
        if found[2] is not None:
            steps.append(int(found[2]) if found[2].isdecimal() and len(found[2]) < 7 else f"[{found[2]}")

    def get(message: Any) -> Any:
        value, holder = message, message
        for step in steps:
            if isinstance(step, int):
                value = value[step]
            elif step.startswith("["):
                value = value[_place(holder, step[1:])]
            else:
                if step not in fields_of(value):  # and nothing else that Python objects have
                    raise LookupError(f"there is no field '{step}'")
                holder, value = value, getattr(value, step)
        return value

    return get


def _place(holder: Any, name: str) -> int:
    names = list(holder.name) if "name" in fields_of(holder) else []
    if name not in names:
        raise LookupError(f"'{name}' is not among its names ({', '.join(map(str, names[:20])) or 'it has no `name`'})")
    return names.index(name)
