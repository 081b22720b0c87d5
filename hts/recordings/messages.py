"""Files of ROS 2 messages, MCAP and SQLite, read without ROS and without running anything that stands in them.

A message's definition comes with the file (MCAP always, SQLite since ROS 2 Iron) or from a text that the mapping names.
Compressed parts are unpacked up to a bound, whatever size they announce.
"""

from __future__ import annotations

import contextlib
import dataclasses
import io
import sqlite3
from collections.abc import Callable, Iterator, Mapping
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

import yaml

from hts.errors import RecordingError, unknown_name
from hts.recordings.table import AGAIN, cannot_be_read

MOST_RECORD = 1 << 28
"""Bytes of one record or unpacked part of a file; writers make parts of about a megabyte."""
MCAP, SQLITE = b"\x89MCAP", b"SQLite format 3\x00"
ROS1, ZSTD = b"#ROSBAG V", b"\x28\xb5\x2f\xfd"
NEEDED = ("mcap", "mcap_ros2")


class Message(NamedTuple):
    """log_time, publish_time: ns, of the recorder; content: as decoded, fields by name."""

    log_time: int
    publish_time: int
    content: Any


class _Raw(NamedTuple):
    log_time: int
    publish_time: int
    data: bytes
    kind: str
    encoding: str
    definition: bytes


def fields_of(content: Any) -> tuple[str, ...]:
    """The names of a decoded message's fields; none of what is no message."""
    return tuple(vars(type(content)).get("__slots__", ()))


def needs_mcap(path: Path) -> None:
    """Raises RecordingError, one line, where the extra is not installed."""
    if any(find_spec(name) is None for name in NEEDED):
        raise RecordingError(
            f"{path}: reading it needs mcap and mcap-ros2-support, which are not installed. "
            "`pip install 'hard-to-sim[ros]'`."
        )


def messages(path: Path, topic: str, definitions: Mapping[str, str]) -> Iterator[Message]:
    """The messages of one topic in the order of the file, which may be an MCAP or SQLite file or a bag's folder.

    definitions: message type, such as "sensor_msgs/msg/JointState" -> its text, for files that hold none. Raises
    RecordingError naming file, topic and what to do for whatever cannot be read.
    """
    needs_mcap(path)
    with _whole(path):
        for file in _files(path):
            yield from _decoded(file, topic, definitions)


def topics(path: Path) -> dict[str, str]:
    """Topic -> message type of everything in a file or bag. Raises RecordingError as `messages`."""
    needs_mcap(path)
    found: dict[str, str] = {}
    with _whole(path):
        for file in _files(path):
            found |= _sqlite_topics(file) if _is(file, SQLITE) else _mcap_topics(file)
    return found


@contextlib.contextmanager
def _whole(path: Path) -> Iterator[None]:
    """Whatever is wrong with the file that is read inside is a RecordingError."""
    try:
        yield
    except RecordingError:
        raise
    except OSError as error:
        raise cannot_be_read(path, error) from error
    except (RecursionError, Exception) as error:  # the libraries know some twenty ways to stumble over a broken file
        what = " ".join(f"{type(error).__name__}: {error}".split())
        raise RecordingError(f"{path}: not a whole file of messages ({what:.160}). Copy it again.") from error


def _files(path: Path) -> list[Path]:
    """The storage files of a bag's folder, in their order; the file itself where it is one. Raises RecordingError where
    there are fewer than its recorder says, or some are packed: what is left would look like the whole recording."""
    if not path.is_dir():
        return [path]
    files = sorted((one for one in path.iterdir() if one.suffix in (".mcap", ".db3")), key=_number)
    packed = sorted(one.name for one in path.iterdir() if one.name.endswith((".mcap.zstd", ".db3.zstd")))
    for name in packed:
        if not (path / name.removesuffix(".zstd")).exists():
            raise RecordingError(f"{path}: part of this bag is packed. Unpack {name} first (`zstd -d`).")
    listed = _listed(path / "metadata.yaml")
    if len(files) < len(listed):  # as many under other names were renamed
        lacking = min(listed - {one.name for one in files}, key=lambda name: _number(Path(name)))
        raise RecordingError(
            f"{path}: metadata.yaml lists {lacking}, which is not in this folder. Copy it too, or name a single file "
            "of the bag if only that part is wanted."
        )
    if not files:
        raise RecordingError(f"{path}: no .mcap or .db3 file in this folder. Name the folder that holds them.")
    return files


def _listed(about: Path) -> set[str]:
    """Names of the storage files, unpacked, that a bag's metadata lists; none where there are no metadata."""
    if not about.exists():
        return set()
    try:
        bag = yaml.safe_load(about.read_text(encoding="utf-8"))["rosbag2_bagfile_information"]
        return {Path(name).name.removesuffix(".zstd") for name in bag["relative_file_paths"]}
    except (yaml.YAMLError, UnicodeDecodeError, LookupError, TypeError) as error:
        raise RecordingError(
            f"{about}: not what a recorder writes (rosbag2_bagfile_information with relative_file_paths). {AGAIN} "
            "Without this file whatever is in the folder is taken for the whole bag."
        ) from error


def _number(path: Path) -> tuple[int, str]:
    """Recorders number the files of a bag: _0, _1, …, _10."""
    last = path.stem.rpartition("_")[2]
    return (int(last) if last.isdecimal() and len(last) < 10 else 0, path.name)


def _other_file(path: Path) -> RecordingError:
    """The error for a file that holds no messages that can be read here."""
    what = "neither an MCAP file nor a ROS 2 bag. Name a .mcap, a .db3 or the bag's folder."
    if _is(path, ROS1):
        what = "a bag of ROS 1, expected one of ROS 2. Convert it: `rosbags-convert` (pip install rosbags)."
    elif path.stat().st_size == 0:
        what = f"nothing stands in it (0 bytes). {AGAIN}"
    return RecordingError(f"{path}: {what}")


def _is(path: Path, magic: bytes) -> bool:
    with path.open("rb") as file:
        return file.read(len(magic)) == magic


def _decoded(path: Path, topic: str, definitions: Mapping[str, str]) -> Iterator[Message]:
    if _is(path, SQLITE):
        raws = _sqlite(path, topic)
    elif _is(path, MCAP):
        raws = _mcap(path, topic)
    else:
        raise _other_file(path)
    decoders: dict[tuple[str, bytes], Callable[[bytes], Any]] = {}
    for raw in raws:
        if raw.data[:1] != b"\0":  # as every message in CDR begins; decoded all the same it would give other numbers
            packed = "is packed by itself (zstd)" if raw.data.startswith(ZSTD) else "is no CDR"
            raise RecordingError(
                f"{path}: topic '{topic}': a message {packed}, it begins with the bytes {raw.data[:4].hex(' ')}. "
                "Expected plain ones: write the bag again without compression (`ros2 bag convert`, compression_mode: "
                "none)."
            )
        key = (raw.kind, raw.definition)
        if key not in decoders:
            decoders[key] = _decoder(path, topic, raw, definitions)
        yield Message(raw.log_time, raw.publish_time, decoders[key](raw.data))


def _check_cdr(path: Path, topic: str, encoding: str) -> None:
    if encoding != "cdr":
        raise RecordingError(f"{path}: topic '{topic}' holds messages in '{encoding}', expected cdr, as ROS 2 does.")


def _decoder(path: Path, topic: str, raw: _Raw, definitions: Mapping[str, str]) -> Callable[[bytes], Any]:
    from mcap.records import Schema
    from mcap_ros2.decoder import DecoderFactory

    text = definitions.get(raw.kind, "").encode() or raw.definition
    if not text:
        raise RecordingError(
            f"{path}: topic '{topic}' is of type {raw.kind}, whose definition is not in the file. Write it into a text "
            "file and name that under `definitions`."
        )
    encoding = "ros2msg" if definitions.get(raw.kind) else raw.encoding
    with contextlib.redirect_stderr(io.StringIO()):  # it prints what it stumbles over before it raises
        decode = DecoderFactory().decoder_for("cdr", Schema(id=1, name=raw.kind, encoding=encoding, data=text))
    if decode is None:
        raise RecordingError(
            f"{path}: topic '{topic}' is written as '{raw.encoding}', expected ROS 2 messages (ros2msg, cdr). Convert "
            "the file, or give the definition under `definitions`."
        )
    return decode


# ------------------------------------------------------------------------------------------------------------- MCAP


def _mcap(path: Path, topic: str) -> Iterator[_Raw]:
    from mcap.records import Channel, Message, Schema

    schemas: dict[int, Schema] = {}
    channels: dict[int, Channel] = {}
    for record in _mcap_records(path):
        if isinstance(record, Schema):
            schemas[record.id] = record
        elif isinstance(record, Channel):
            channels[record.id] = record
        elif isinstance(record, Message):
            channel = channels[record.channel_id]
            if channel.topic != topic:
                continue
            _check_cdr(path, topic, channel.message_encoding)
            schema = schemas[channel.schema_id]
            times = record.log_time, record.publish_time
            yield _Raw(*times, record.data, schema.name, schema.encoding, schema.data)


def _mcap_topics(path: Path) -> dict[str, str]:
    from mcap.records import Channel, Schema

    if not _is(path, MCAP):
        raise _other_file(path)
    schemas, found = {0: ""}, {}
    for record in _mcap_records(path):
        if isinstance(record, Schema):
            schemas[record.id] = record.name
        elif isinstance(record, Channel):
            found[record.topic] = schemas.get(record.schema_id, "")
    return found


def _mcap_records(path: Path) -> Iterator[Any]:
    """Records in the order of the file. Raises RecordingError where a file ends too early."""
    from mcap.exceptions import EndOfFile
    from mcap.records import Chunk
    from mcap.stream_reader import StreamReader, breakup_chunk

    with path.open("rb") as file:
        reader = StreamReader(file, emit_chunks=True, record_size_limit=MOST_RECORD)
        try:
            for record in reader.records:
                if isinstance(record, Chunk):
                    yield from breakup_chunk(_unpacked(path, record), validate_crc=True)
                else:
                    yield record
        except EndOfFile:
            raise RecordingError(
                f"{path}: the file ends too early, as when a recorder is killed. Copy it again, or `mcap recover` it."
            ) from None


def _unpacked(path: Path, chunk: Any) -> Any:
    """The same part of a file, its data plain, and no more of them than it announces and we allow."""
    size = chunk.uncompressed_size
    if size > MOST_RECORD:
        raise RecordingError(f"{path}: a part of {size:.3g} bytes, at most {MOST_RECORD:.3g} are read. Copy it again.")
    if chunk.compression == "zstd":
        import zstandard

        data = zstandard.ZstdDecompressor().stream_reader(io.BytesIO(chunk.data)).read(size + 1)
    elif chunk.compression == "lz4":
        import lz4.frame

        data = lz4.frame.LZ4FrameDecompressor().decompress(chunk.data, max_length=size + 1)
    elif not chunk.compression:
        data = chunk.data
    else:
        raise RecordingError(f"{path}: packed by '{chunk.compression:.40}', expected zstd, lz4 or nothing. Convert it.")
    if len(data) != size:
        raise RecordingError(f"{path}: a part of it unpacks to another size than {size} bytes. Copy it again.")
    return dataclasses.replace(chunk, compression="", data=data)


# ----------------------------------------------------------------------------------------------------------- SQLite


def _opened(path: Path) -> sqlite3.Connection:
    """The database, not to be written, its own functions switched off. Raises RecordingError where messages lie beside
    it that were never merged: SQLite does not see them in a file that it may not write to."""
    for ending in ("-wal", "-journal"):
        beside = path.with_name(path.name + ending)
        if beside.exists() and beside.stat().st_size:
            raise RecordingError(
                f"{beside}: holds what {path.name} does not have yet, since its recorder was stopped or goes on. Let "
                f"it end, then merge the two: sqlite3 {path} 'PRAGMA journal_mode=DELETE'."
            )
    base = sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro&immutable=1", uri=True)
    base.execute("PRAGMA trusted_schema=OFF")
    base.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, MOST_RECORD)
    return base


def _sqlite(path: Path, topic: str) -> Iterator[_Raw]:
    with contextlib.closing(_opened(path)) as base:
        known = base.execute("SELECT id, type, serialization_format FROM topics WHERE name = ?", (topic,)).fetchall()
        texts = _sqlite_definitions(base)
        for number, kind, form in known:
            _check_cdr(path, topic, form)
            # Not by their stamps: that would mix two stretches where the recorder's clock was set back.
            rows = base.execute("SELECT timestamp, data FROM messages WHERE topic_id = ? ORDER BY id", (number,))
            encoding, text = texts.get(kind, ("ros2msg", b""))
            for stamp, data in rows:
                yield _Raw(int(stamp), int(stamp), bytes(data), kind, encoding, text)


def _sqlite_definitions(base: sqlite3.Connection) -> dict[str, tuple[str, bytes]]:
    try:
        rows = base.execute("SELECT topic_type, encoding, encoded_message_definition FROM message_definitions")
        return {kind: (encoding, text.encode()) for kind, encoding, text in rows}
    except sqlite3.OperationalError:  # before ROS 2 Iron there was no such table
        return {}


def _sqlite_topics(path: Path) -> dict[str, str]:
    with contextlib.closing(_opened(path)) as base:
        return {str(name): str(kind) for name, kind in base.execute("SELECT name, type FROM topics")}


def no_topic(path: Path, topic: str) -> RecordingError:
    """The error for a topic that a file does not have, or has no messages of."""
    found = topics(path)
    if topic in found:
        return RecordingError(
            f"{path}: topic '{topic}' ({found[topic]}) has no messages. Record again, or name another."
        )
    if not found:
        return RecordingError(f"{path}: there is no topic in it. Record again.")
    return RecordingError(f"{path}: " + unknown_name("topic", topic, found))
