"""Made-up files of ROS 2 messages, for tests: MCAP by its own writer, SQLite as rosbag2 lays it out."""

from __future__ import annotations

import io
import sqlite3
from pathlib import Path
from typing import Any

import numpy as np

STEPS = np.arange(40)
START = 1_763_146_355_421_617_551  # ns: of today, too long for a float
JOINT_STATE = """std_msgs/Header header
string[] name
float64[] position
float64[] velocity
float64[] effort
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
"""
GAUGE = "float32 amps\nuint8 percent\n"


def joint_state(step: int, late_ns: int = 0) -> dict[str, Any]:
    """Knee before hip; effort step/10 of the hip, minus that of the knee; stamped by a clock that is late."""
    stamp = START + 20_000_000 * step - late_ns
    return {
        "header": {"stamp": {"sec": stamp // 10**9, "nanosec": stamp % 10**9}, "frame_id": "base"},
        "name": ["knee", "hip"],
        "position": [0.0, 0.1],
        "velocity": [0.0, 0.0],
        "effort": [-step / 10, step / 10],
    }


def gauge(step: int) -> dict[str, Any]:
    return {"amps": -(2 + step / 100), "percent": 80}


TOPICS = {
    "/joint_states": ("sensor_msgs/msg/JointState", JOINT_STATE, joint_state),
    "/gauge": ("lab/msg/Gauge", GAUGE, gauge),
}


def mcap(
    path: Path, steps: np.ndarray = STEPS, compression: str = "ZSTD", topics: dict[str, Any] | None = None
) -> Path:
    """Both topics, the gauge 5 ms after the joints."""
    from mcap.writer import CompressionType
    from mcap_ros2.writer import Writer

    with path.open("wb") as file:
        writer = Writer(file, compression=CompressionType[compression])
        topics = topics or TOPICS
        kinds = {topic: writer.register_msgdef(kind, text) for topic, (kind, text, _) in topics.items()}
        for step in steps.tolist():
            for delay, (topic, (_, _, content)) in enumerate(topics.items()):
                when = START + 20_000_000 * step + 5_000_000 * delay
                writer.write_message(topic, kinds[topic], content(step), log_time=when, publish_time=when)
        writer.finish()
    return path


def encoded(kind: str, text: str, content: dict[str, Any]) -> bytes:
    """One message as CDR, by the library's own writer."""
    from mcap.reader import make_reader
    from mcap_ros2.writer import Writer

    written = io.BytesIO()
    writer = Writer(written)
    writer.write_message("/x", writer.register_msgdef(kind, text), content, log_time=1)
    writer.finish()
    written.seek(0)
    return bytes(next(iter(make_reader(written).iter_messages()))[2].data)


def sqlite(path: Path, definitions: bool = True, topics: dict[str, Any] | None = None) -> Path:
    """The same as rosbag2 writes it to SQLite; before ROS 2 Iron without definitions."""
    base = sqlite3.connect(path)
    base.executescript(
        "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format TEXT, qos TEXT);"
        "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data BLOB);"
    )
    if definitions:
        base.execute(
            "CREATE TABLE message_definitions(id INTEGER PRIMARY KEY, topic_type TEXT, encoding TEXT, "
            "encoded_message_definition TEXT)"
        )
    for number, (topic, (kind, text, content)) in enumerate((topics or TOPICS).items()):
        base.execute("INSERT INTO topics VALUES (?, ?, ?, 'cdr', '')", (number, topic, kind))
        if definitions:
            base.execute("INSERT INTO message_definitions VALUES (?, ?, 'ros2msg', ?)", (number, kind, text))
        for step in STEPS.tolist():
            row = (number, START + 20_000_000 * step, encoded(kind, text, content(step)))
            base.execute("INSERT INTO messages(topic_id, timestamp, data) VALUES (?, ?, ?)", row)
    base.commit()
    base.close()
    return path
