"""What mjlab writes into the ONNX files that it exports, and what we add: read and written.

mjlab (mjlab/rl/exporter_utils.py, 1.6): comma-separated text under joint_names, default_joint_pos, action_scale,
joint_stiffness, joint_damping, observation_names, observation_terms_scale, …_clip, …_history_length,
…_flatten_history_dim, command_names, run_path; numbers rounded to three decimals. Ours are in full precision.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from hts.errors import PolicyError
from hts.policies.contract import Contract
from hts.policies.onnx_checks import metadata_in, read_checked
from hts.policies.source import Source, sized
from hts.policies.terms import our_name

LONGEST = 100_000  # characters of one entry
NUMBERS = {
    "default_joint_pos": "default_pose",
    "joint_stiffness": "kp",
    "joint_damping": "kd",
    "action_scale": "action_scale",
}
THEIRS = {
    "angular_velocity": "base_ang_vel",
    "joint_position_offset": "joint_pos",
    "joint_velocity": "joint_vel",
    "last_action": "actions",
}
"""Our part -> mjlab's name of it, where they differ."""


def read_metadata(path: Path) -> Source:
    """What the metadata of an ONNX file say. Raises PolicyError for a broken file, or metadata that are no such."""
    return metadata_of(path, metadata_in(read_checked(path)))


def metadata_of(path: Path, properties: Mapping[str, str]) -> Source:
    """The contract and the observation in metadata that mjlab or we wrote; empty if there are none."""
    if any(len(value) > LONGEST for value in properties.values()):
        raise PolicyError(f"{path}: its metadata are longer than any policy's. Export it again.")
    said: dict[str, Any] = {}
    if properties.get("joint_names"):
        said["joint_names"] = tuple(properties["joint_names"].split(","))
    for theirs, ours in NUMBERS.items():
        if theirs in properties:
            numbers = _numbers(path, theirs, properties[theirs])
            said[ours] = numbers[0] if len(numbers) == 1 else numbers
    if "control_dt" in properties:
        (step,) = _numbers(path, "control_dt", properties["control_dt"], 1)
        if not step > 0:
            raise PolicyError(f"{path}: its metadata say control_dt {step:g}, expected seconds above 0.")
        said["control_rate_hz"] = 1.0 / step
    if "action_delay_seconds" in properties:
        delay = _numbers(path, "action_delay_seconds", properties["action_delay_seconds"], 2)
        said["delay_seconds"] = (delay[0], delay[1])
    contract = Contract(**said, said_by=dict.fromkeys(said, f"the metadata of {path.name}"))
    return Source(contract, _observation(path, properties, len(contract.joint_names or ())))


def _observation(path: Path, properties: Mapping[str, str], joints: int) -> tuple[Mapping[str, Any], ...]:
    names = [name for name in properties.get("observation_names", "").split(",") if name]
    if not names or not joints:
        return ()
    for key in ("observation_terms_history_length",):
        if any(float(one) > 1 for one in _numbers(path, key, properties.get(key, ""))):
            raise PolicyError(f"{path}: it sees several observations at once, hts shows one.")
    scales = [entry.split(";") for entry in properties.get("observation_terms_scale", "").split(",") if entry]
    scales = scales or [["1"]] * len(names)
    if len(scales) != len(names):
        raise PolicyError(f"{path}: its metadata have {len(scales)} scales for {len(names)} observations.")
    parts = []
    for name, entry in zip(names, scales, strict=True):
        values = _numbers(path, "observation_terms_scale", ",".join(entry))
        parts.append({"name": our_name(name), "scale": values[0] if len(values) == 1 else values})
    return sized(tuple(parts), joints)


def _numbers(path: Path, key: str, text: str, count: int | None = None) -> tuple[float, ...]:
    try:
        values = tuple(float(entry) for entry in text.split(",") if entry)
    except ValueError as error:
        raise PolicyError(f"{path}: its metadata say {key} '{text[:60]}', expected numbers.") from error
    if not all(math.isfinite(value) for value in values) or (count is not None and len(values) != count):
        raise PolicyError(f"{path}: its metadata say {key} '{text[:60]}', expected {count or 'finite'} numbers.")
    return values


def metadata_of_policy(policy: Any) -> dict[str, str]:
    """What mjlab writes, of one of our policies (a Policy), and what it lacks: control_dt s, action_sigma action units,
    observation_terms_size, and action_delay_seconds (least and most that it was trained with) where its card says."""
    card = policy.card
    parts = [(THEIRS.get(str(part["name"]), str(part["name"])), int(part["size"])) for part in card.observation]
    count = len(parts)
    said = {
        "run_path": "hts",
        "joint_names": ",".join(card.joint_names),
        "joint_stiffness": _csv(card.kp),
        "joint_damping": _csv(card.kd),
        "default_joint_pos": _csv(card.default_pose),
        "command_names": ",".join(name for name, _ in parts if name == "command"),
        "observation_names": ",".join(name for name, _ in parts),
        "observation_terms_size": ",".join(str(size) for _, size in parts),
        "observation_terms_scale": ",".join(["1.0"] * count),
        "observation_terms_flatten_history_dim": ",".join(["True"] * count),
        "observation_terms_history_length": ",".join([str(card.history if card.history > 1 else 0)] * count),
        "observation_terms_clip": ",".join(["-inf;inf"] * count),
        "action_scale": _csv(card.action_scale),
        "control_dt": repr(1.0 / card.control_rate_hz),
        "action_sigma": _csv(policy.tensors["log_std"].exp().tolist()),
    }
    delay = card.made.get("delay_seconds") or (card.made.get("source") or {}).get("delay_seconds")
    if isinstance(delay, list | tuple) and len(delay) == 2:
        said["action_delay_seconds"] = _csv(delay)
    return said


def _csv(values: Sequence[float]) -> str:
    """In full precision: what is read back is the number itself."""
    return ",".join(repr(float(value)) for value in values)
