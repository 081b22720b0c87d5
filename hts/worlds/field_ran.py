"""Whose walk a log shows: its joint targets are held against what each policy of the bundle would have asked for.

A log of another policy of the bundle is refused where that one fits clearly better. A log of none of them cannot be
told by itself from one of a runner that filters, or of a logger that is late or noisy. So it is refused only where
other logs of the same visit show, each with its own policy, that what was asked for can be computed again there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hts.errors import RecordingError
from hts.policies.deploy import DeployedPolicy
from hts.recordings.recording import Recording

FEWEST = 50  # rows
LEAST = 1e-4  # rad: what is nearer than that differs by a log's decimals
CLEARLY = 0.5  # of how far the stated policy's targets are off: another one's that are nearer than this are whose it is
AGREES = 0.1  # of how much the targets move: what is farther off shows nobody's policy, such as through a filter
STRANGE = 0.3
"""Of how much the targets move: a row of which three quarters are farther off is of another policy, where other logs of
the visit agree. Walks of a twin with a log that is rounded, half a row late, noisy, smoothed, or whose IMU is 0.2 s
late: 0.16 at most. Walks of eight policies of one robot, each held against the seven others: 0.22 to 1.8, in one pair
of twenty below 0.3, the least of two that one run fine-tuned in iterations one after the other."""
MOVING = 0.05  # rad: targets that move less are those of a robot that stands, of which noise is a large share
LATE = range(4)  # rows by which a state may be logged before the target that was computed from it


def check_whose(files: Sequence[Path], recordings: Sequence[Recording], policies: Sequence[Path]) -> None:
    """Raise RecordingError for a log whose joint targets are those of another policy of the bundle, or of none (see
    `_check_stranger`), for robots whose targets are default_pose + action_scale * action. files, recordings, policies
    (ONNX, without noise): of each row.

    A log that lacks something that a policy observes, or is not at its rate, says nothing; noise of a policy that
    explores is in all differences alike.
    """
    if len(recordings) < 2:
        return
    loaded = {path: DeployedPolicy(path) for path in dict.fromkeys(policies)}
    _check_exchanged(files, recordings, policies, loaded)
    _check_stranger(files, recordings, policies, loaded)


def _check_exchanged(
    files: Sequence[Path],
    recordings: Sequence[Recording],
    policies: Sequence[Path],
    loaded: dict[Path, DeployedPolicy],
) -> None:
    hashes = [str(loaded[path].card.policy_hash) for path in policies]
    known = {one: (path.name, loaded[path]) for one, path in reversed([*zip(hashes, policies, strict=True)])}
    if len(known) < 2:
        return
    for file, recording, own in zip(files, recordings, hashes, strict=True):
        off = {one: distance(policy, recording) for one, (_, policy) in known.items()}
        found = {one: value for one, value in off.items() if value is not None}
        mine, best = found.get(own, 0.0), min(found, key=lambda one: found[one], default=own)
        if mine < LEAST or found[best] >= CLEARLY * mine or found[best] > AGREES * moves(recording):
            continue
        raise RecordingError(
            f"{file}: its joint targets are those of {known[best][0]} (computed again from the log, off by "
            f"{found[best]:.2g} rad), not of {known[own][0]} (off by {mine:.2g} rad), of which this row is. Put "
            "there the log of this row, or record the row again."
        )


@dataclass(frozen=True)
class _Row:
    """How far the targets of one log are from those of its own policy in half, and in three quarters, of its samples at
    least; moves: how much they move; all rad."""

    half: float
    most: float
    moves: float


def _check_stranger(
    files: Sequence[Path],
    recordings: Sequence[Recording],
    policies: Sequence[Path],
    loaded: dict[Path, DeployedPolicy],
) -> None:
    """Raise RecordingError for a log that its own policy did not make, where at least as many of the others agree with
    theirs. Not asked: rows that explore, in which the robot fell or stands, and visits in which no log agrees."""
    rows: dict[int, _Row] = {}
    for number, (recording, path) in enumerate(zip(recordings, policies, strict=True)):
        size = moves(recording) if "joint_target" in recording.channels else 0.0
        if size < MOVING or recording.fell or loaded[path].card.exploration_std:
            continue
        off = nearest(loaded[path], recording)
        if off is not None:
            rows[number] = _Row(float(np.median(off)), float(np.quantile(off, 0.25)), size)
    agree = [row for row in rows.values() if row.half <= AGREES * row.moves]
    if not agree or len(agree) < len(rows) - len(agree):
        return
    for number, row in rows.items():
        most = STRANGE * max(row.moves, *(one.moves for one in agree))
        if row.most > most:
            name = policies[number].name
            raise RecordingError(
                f"{files[number]}: its joint targets are not those of {name}, of which this row is, nor clearly of "
                f"another policy of the bundle: computed again from the log they are off by {row.most:.2g} rad and "
                f"more in three quarters of it; expected less than {most:.2g}, as in other logs of this visit "
                f"({len(agree)}). Run that row's policy, {name}, and record the row again; if it did run, the log "
                "holds other states than the policy was given: correct its mapping, or leave joint_target out of it."
            )


def distance(policy: DeployedPolicy, recording: Recording) -> float | None:
    """How far a log's joint targets are from those that the policy asks for in its place, rad, root mean square; None
    where the log does not show it. The state that a target came from is in its row, or up to three rows before."""
    off = differences(policy, recording)
    return None if off is None else min(float(np.sqrt(np.mean(one**2))) for one in off)


def nearest(policy: DeployedPolicy, recording: Recording) -> np.ndarray | None:
    """By how much the log's targets are off in each sample, (T,), rad, for the best of the delays LATE."""
    off = differences(policy, recording)
    return None if off is None else min(off, key=lambda one: float(np.median(one)))


def differences(policy: DeployedPolicy, recording: Recording) -> list[np.ndarray] | None:
    """The same in each sample, (T,), root mean square over joints; one for each of the rows LATE by which the state
    may be logged before the target. Samples whose past is not in the log are left out. None as `distance`."""
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
    first, found = card.history + LATE[-1], []
    for offset in LATE:
        seen = {
            name: held[name] if name in ("last_action", "command") else np.roll(held[name], offset, axis=0)
            for name in sizes
        }
        off = (scale * (policy.replayed(seen) - actions))[first:]
        found.append(np.sqrt(np.mean(off**2, axis=1)))
    return found if all(np.isfinite(one).all() for one in found) else None


def moves(recording: Recording) -> float:
    """How much the joint targets of a log move, rad, root mean square over joints."""
    return float(np.sqrt(np.mean(np.var(recording.channels["joint_target"].values, axis=0))))
