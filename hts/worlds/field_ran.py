"""Whose walk a log shows: its joint targets are held against what each policy of the bundle would have asked for."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from hts.errors import RecordingError
from hts.policies.deploy import DeployedPolicy
from hts.recordings.recording import Recording

FEWEST = 50  # rows
LEAST = 1e-4  # rad: what is nearer than that differs by a log's decimals
CLEARLY = 0.5  # of how far the stated policy's targets are off: another one's that are nearer than this are whose it is
AGREES = 0.1  # of how much the targets move: what is farther off shows nobody's policy, such as through a filter


def check_whose(files: Sequence[Path], recordings: Sequence[Recording], policies: Sequence[Path]) -> None:
    """Raise RecordingError for a log whose joint targets are those of another policy of the bundle, for robots whose
    targets are default_pose + action_scale * action. files, recordings, policies (ONNX, without noise): of each row.

    A log that lacks something that a policy observes, or is not at its rate, says nothing; noise of a policy that
    explores is in all differences alike.
    """
    loaded = {path: DeployedPolicy(path) for path in dict.fromkeys(policies)}
    hashes = [str(loaded[path].card.policy_hash) for path in policies]
    known = {one: (path.name, loaded[path]) for one, path in reversed([*zip(hashes, policies, strict=True)])}
    if len(known) < 2:
        return
    for file, recording, own in zip(files, recordings, hashes, strict=True):
        off = {one: distance(policy, recording) for one, (_, policy) in known.items()}
        found = {one: value for one, value in off.items() if value is not None}
        mine, nearest = found.get(own, 0.0), min(found, key=lambda one: found[one], default=own)
        if mine < LEAST or found[nearest] >= CLEARLY * mine or found[nearest] > AGREES * _moves(recording):
            continue
        raise RecordingError(
            f"{file}: its joint targets are those of {known[nearest][0]} (computed again from the log, off by "
            f"{found[nearest]:.2g} rad), not of {known[own][0]} (off by {mine:.2g} rad), of which this row is. Put "
            "there the log of this row, or record the row again."
        )


def distance(policy: DeployedPolicy, recording: Recording) -> float | None:
    """How far a log's joint targets are from those that the policy asks for in its place, rad, root mean square; None
    where the log does not show it. The state that a target came from is in its row, or in the row before."""
    card = policy.card
    held = {name: np.asarray(series.values, np.float64) for name, series in recording.channels.items()}
    if abs(recording.rate_hz / card.control_rate_hz - 1.0) > 0.01 or {*card.joint_names} != {*recording.joint_names}:
        return None
    order = [recording.joint_names.index(name) for name in card.joint_names]
    for name, values in held.items():
        if name.startswith("joint_") and values.shape[1:] == (len(order),):
            held[name] = values[:, order]
    if "joint_target" not in held or len(held["joint_target"]) < FEWEST + card.history:
        return None
    pose, scale = np.asarray(card.default_pose), np.asarray(card.action_scale)
    if "joint_position" in held:
        held["joint_position_offset"] = held["joint_position"] - pose
    actions = (held["joint_target"] - pose) / scale
    held["last_action"] = np.vstack([np.zeros_like(actions[:1]), actions[:-1]])
    sizes = {str(part["name"]): int(part["size"]) for part in card.observation}
    if any(name not in held or held[name].shape[1:] != (size,) for name, size in sizes.items()):
        return None
    first, found = card.history + 1, []
    for offset in (0, 1):
        seen = {
            name: held[name] if name in ("last_action", "command") else np.roll(held[name], offset, axis=0)
            for name in sizes
        }
        off = (scale * (policy.replayed(seen) - actions))[first:]
        found.append(float(np.sqrt(np.mean(off**2))))
    return min(found) if np.isfinite(found).all() else None


def _moves(recording: Recording) -> float:
    """How much the joint targets of a log move, rad, root mean square over joints."""
    return float(np.sqrt(np.mean(np.var(recording.channels["joint_target"].values, axis=0))))
