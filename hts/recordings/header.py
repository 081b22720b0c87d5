"""A recording's attributes as JSON, and the hashes that name it.

    array digest  = SHA-256 of dtype, shape and the decoded little-endian samples
    recording id  = first 16 hex digits of SHA-256 over the attributes, which contain the array digests
    dataset hash  = SHA-256 over the sorted ids with their array digests

So an id vouches for every attribute and every sample, and none of them depends on chunks or compression.
Each array also has a CRC-32, eight times faster than SHA-256 here: every read checks the one, `dataset` and
`validate` the other.
"""

from __future__ import annotations

import hashlib
import json
import math
import re
import zlib
from typing import Any

import numpy as np

from hts import units
from hts.channels import Channel
from hts.config import ScheduleConfig
from hts.recordings.recording import Recording, Series

SCHEMA_VERSION = 1
LONGEST_NAME = 200  # characters
MOST_NUMBERS = 1 << 31  # of one array: a hundred joints at 1 kHz for six hours
ID_PATTERN = re.compile(r"[0-9a-f]{16}")


def array_digest(values: np.ndarray) -> str:
    """SHA-256 hex digest of decoded samples, independent of byte order in memory and of storage."""
    plain = _plain(values)
    digest = hashlib.sha256(json.dumps([plain.dtype.str, list(values.shape)]).encode())
    digest.update(plain.reshape(-1).view(np.uint8).data)
    return digest.hexdigest()


def array_checksum(values: np.ndarray) -> str:
    """CRC-32 of the decoded little-endian samples, 8 hex digits. Finds damage, proves nothing."""
    return f"{zlib.crc32(_plain(values).reshape(-1).view(np.uint8).data):08x}"


def _plain(values: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(values, dtype=values.dtype.newbyteorder("<"))


def to_attributes(recording: Recording) -> dict[str, Any]:
    """Everything about a recording but its samples, as plain JSON values."""
    arrays: dict[str, Any] = {
        "time": {
            "unit": "s",
            "rate_hz": float(recording.rate_hz),
            "shape": [],
            "description": f"clock: {recording.clock}",
            "sha256": array_digest(recording.time),
            "crc32": array_checksum(recording.time),
        }
    }
    for name, series in sorted(recording.channels.items()):
        channel = series.channel
        arrays[name] = {
            "unit": channel.unit,
            "rate_hz": float(recording.rate_hz),
            "shape": list(channel.shape),
            "description": channel.description,
            "may_be_constant": channel.may_be_constant,
            "sha256": array_digest(series.values),
            "crc32": array_checksum(series.values),
        }
    return {
        "schema_version": SCHEMA_VERSION,
        "robot": recording.robot,
        "world": recording.world,
        "policy_hash": recording.policy_hash,
        "iteration": int(recording.iteration),
        "joint_names": list(recording.joint_names),
        "kp": [float(gain) for gain in recording.kp],
        "kd": [float(gain) for gain in recording.kd],
        "rate_hz": float(recording.rate_hz),
        "samples": recording.num_samples,
        "schedule": recording.schedule.model_dump(mode="json"),
        "idle": {name: float(level) for name, level in sorted(recording.idle.items())},
        "clock": recording.clock,
        "mass_kg": None if recording.mass_kg is None else float(recording.mass_kg),
        "session": recording.session,
        "block": int(recording.block),
        "role": recording.role,
        "fell": bool(recording.fell),
        "notes": {str(key): str(text) for key, text in sorted(recording.notes.items())},
        "arrays": arrays,
    }


def fault_of(attributes: dict[str, Any]) -> str | None:
    """What makes attributes unfit to be used, whoever wrote them; None if nothing does.

    Names of arrays become paths and shapes become memory, so neither is taken on trust because an id fits its content.
    """
    arrays, samples = attributes.get("arrays"), attributes.get("samples")
    if not isinstance(arrays, dict) or "time" not in arrays:
        return "no 'arrays' with a 'time'"
    if not isinstance(samples, int) or isinstance(samples, bool) or samples < 1:
        return f"samples {samples!r:.40}, expected a number of at least 1"
    for name, about in arrays.items():
        if not name.isidentifier() or len(name) > LONGEST_NAME:
            return f"an array named {name!r:.80}, expected letters, digits and _"
        shape = about.get("shape") if isinstance(about, dict) else None
        if not isinstance(shape, list) or not all(isinstance(size, int) and size > 0 for size in shape):
            return f"'{name}' of shape {shape!r:.40}, expected a list of sizes"
        if math.prod([samples, *shape]) > MOST_NUMBERS:
            return (
                f"'{name}' of {math.prod([samples, *shape]):.3g} numbers, more than any recording ({MOST_NUMBERS:.3g})"
            )
        if not all(isinstance(about.get(key), str) for key in ("unit", "sha256", "crc32")):
            return f"'{name}' without unit or hash"
    return None


def content_id(attributes: dict[str, Any]) -> str:
    """The id that these attributes deserve. Raises ValueError if they hold NaN or something that is not JSON."""
    text = json.dumps(attributes, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def from_attributes(
    attributes: dict[str, Any], time: np.ndarray, values: dict[str, np.ndarray], recording_id: str
) -> Recording:
    """The recording with the channels in `values`. Raises KeyError, TypeError or ValueError if something is missing."""
    channels = {}
    for name, samples in values.items():
        about = attributes["arrays"][name]
        units.keep(about["unit"])  # the plugin that defined it need not be here for its recordings to open
        channel = Channel(name, about["unit"], tuple(about["shape"]), about["description"], about["may_be_constant"])
        channels[name] = Series(channel, samples)
    return Recording(
        robot=attributes["robot"],
        world=attributes["world"],
        policy_hash=attributes["policy_hash"],
        iteration=attributes["iteration"],
        joint_names=tuple(attributes["joint_names"]),
        kp=tuple(attributes["kp"]),
        kd=tuple(attributes["kd"]),
        rate_hz=attributes["rate_hz"],
        schedule=ScheduleConfig.model_validate(attributes["schedule"]),
        idle=attributes["idle"],
        clock=attributes["clock"],
        time=time,
        channels=channels,
        mass_kg=attributes["mass_kg"],
        session=attributes["session"],
        block=attributes["block"],
        role=attributes["role"],
        fell=attributes["fell"],
        notes=attributes["notes"],
        id=recording_id,
    )


def dataset_digest(members: dict[str, dict[str, str]]) -> str:
    """SHA-256 over a dataset. members: id -> array name -> digest of the decoded array; their order does not matter."""
    text = json.dumps(members, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()
