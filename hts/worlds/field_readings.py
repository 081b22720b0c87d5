"""Whether a log read in another way is its policy's: legs exchanged in all joint channels, a gyroscope along other
axes, a yaw rate in deg/s.

Where joints are exchanged in positions, speeds, torques and targets alike, the log agrees with itself and nothing in it
looks wrong. What the policy makes of it does: computed again from the log, its targets are those of the log only if
every number that it saw is where it belongs. So a log that its own policy does not explain is read in some other ways,
and refused where one of these explains it and the log as it is read does not.

Where the numbers come from: logs of the default twin and of 16 drawn ones, six walks each, are off by nothing as they
are; with left and right exchanged by 0.8 to 1.2 of how much the targets move, with x and y of the gyroscope exchanged
by 0.04 to 0.17, and by nothing again read rightly. Noise, delays and filters of a logger are in all readings alike.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import permutations, product
from pathlib import Path

import numpy as np

from hts.errors import RecordingError
from hts.policies.deploy import DeployedPolicy
from hts.recordings.recording import Recording, Series
from hts.worlds.field_ran import AGREES, MOVING, moves, nearest

OFF = 0.02
"""Of how much the targets move: a log that is off by less is its policy's."""
EXPLAINED, APART = 0.25, 0.5
"""A reading explains a log if it brings its median so much nearer, and three quarters of its samples nearer than so
much of what three quarters are off as the log is read."""
MOST_LOGS = 3
"""Of a visit that are read otherwise: a mapping that is wrong is wrong of all of them."""
MOST_SAMPLES = 1000
MOST_GROUPS = 4
"""Legs, or parts of a leg, that are tried in every order."""

Change = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Reading:
    """Another way to read a log. changes: channel -> what becomes of its values (T, ...); words: which way, as in "with
    ..."; remedy: what to correct."""

    changes: Mapping[str, Change]
    words: str
    remedy: str

    def of(self, recording: Recording) -> Recording:
        """The recording as it would have been read so."""
        changed = {
            name: Series(series.channel, self.changes[name](series.values))
            for name, series in recording.channels.items()
            if name in self.changes
        }
        return recording.replace(channels={**recording.channels, **changed})


def check_readings(files: Sequence[Path], recordings: Sequence[Recording], policies: Sequence[Path]) -> None:
    """Raise RecordingError, one line, for a log that its own policy explains only if it is read in another way.

    files, recordings, policies (ONNX, without noise): of each row, for robots whose targets are default_pose +
    action_scale * action. Nothing is said of a robot that stands or fell, nor of a log that lacks something that its
    policy observes or its targets.
    """
    looked = 0
    for file, recording, path in zip(files, recordings, policies, strict=True):
        if looked == MOST_LOGS:
            return
        if recording.fell or "joint_target" not in recording.channels:
            continue
        policy, part = DeployedPolicy(path), _middle(recording)
        size = moves(part)
        own = nearest(policy, part)
        if size < MOVING or own is None or float(np.median(own)) <= OFF * size:
            continue
        looked += 1
        found = _explaining(policy, part, own, AGREES * size)
        if found is not None:
            reading, off = found
            raise RecordingError(
                f"{file}: computed again from the log, the joint targets of {path.name} are off by "
                f"{float(np.median(own)):.2g} rad as it is read, but by {off:.2g} rad with {reading.words}. Expected "
                f"less than {AGREES * size:.2g} rad: {reading.remedy}. If the log is right as it is read, leave "
                "joint_target out of the mapping, and nothing is computed again."
            )


def _explaining(
    policy: DeployedPolicy, recording: Recording, own: np.ndarray, most: float
) -> tuple[Reading, float] | None:
    """The reading that explains the log best, and by how much it is off then, rad; None if none does. own: (T,) by how
    much the log is off as it is read; most: by how much it may be off, rad."""
    explained = []
    for reading in readings(recording):
        off = nearest(policy, reading.of(recording))
        if off is None:
            continue
        middle = float(np.median(off))
        apart = np.quantile(off, 0.75) < APART * np.quantile(own, 0.25)
        if middle < min(most, EXPLAINED * float(np.median(own))) and apart:
            explained.append((middle, reading))
    if not explained:
        return None
    least, best = min(explained, key=lambda one: one[0])
    return best, least


def readings(recording: Recording) -> Iterator[Reading]:
    """Other ways to read a log, one fault each."""
    yield from _joints(recording.joint_names)
    for channels in (("angular_velocity",), ("projected_gravity",), ("angular_velocity", "projected_gravity")):
        if all(name in recording.channels for name in channels):
            yield from _axes(channels)
    if "angular_velocity" in recording.channels:
        yield Reading(
            {"angular_velocity": np.radians},
            "angular_velocity taken as deg/s",
            "say unit: deg/s in channels.angular_velocity of the mapping",
        )
    if "command" in recording.channels:
        yield from _commands()


def _joints(names: Sequence[str]) -> Iterator[Reading]:
    """Legs exchanged, or parts of each leg, in all channels of joints: groups that the names tell of, such as FR and FL
    of FR_hip, FL_hip, FR_knee, FL_knee, and hip and knee."""
    words = [name.split("_") for name in names]
    for place in range(min(map(len, words))):
        groups = dict.fromkeys(one[place] for one in words)
        at = {(one[place], *one[:place], *one[place + 1 :]): joint for joint, one in enumerate(words)}
        rest = {key[1:] for key in at}
        if not 1 < len(groups) <= MOST_GROUPS or len(at) != len(groups) * len(rest) or len(at) != len(names):
            continue
        for order in permutations(groups):
            taken = dict(zip(groups, order, strict=True))
            if all(one == other for one, other in taken.items()):
                continue
            joints = [at[taken[one[place]], *one[:place], *one[place + 1 :]] for one in words]
            shown = ", ".join(f"its {other} taken as {one}" for one, other in taken.items() if one != other)
            yield Reading(
                {name: _columns(joints) for name in JOINT_CHANNELS},
                f"{shown} in all channels of joints",
                "correct `joints`, `joint_order` or the columns in the mapping, or what writes the log",
            )


JOINT_CHANNELS = ("joint_position", "joint_velocity", "joint_torque", "joint_target")


def _axes(channels: Sequence[str]) -> Iterator[Reading]:
    """Axes exchanged or counted the other way: x and y with all signs, and the other orders of x, y and z."""
    forward = (1.0, 1.0, 1.0)
    signed = [*product(((0, 1, 2), (1, 0, 2)), product((1.0, -1.0), repeat=3))]
    for order, signs in [*signed, *((order, forward) for order in permutations(range(3)) if order[2] != 2)]:
        if order == (0, 1, 2) and signs == forward:
            continue
        shown = ", ".join(f"{'-' if sign < 0 else ''}{'xyz'[axis]}" for axis, sign in zip(order, signs, strict=True))
        yield Reading(
            {name: _columns(order, signs) for name in channels},
            f"{' and '.join(channels)} taken as ({shown}) of what the log calls (x, y, z)",
            "expected are the trunk's own axes, x forward, y left, z up: correct "
            f"{' and '.join(f'channels.{name}' for name in channels)} in the mapping, or turn it in the log",
        )


def _commands() -> Iterator[Reading]:
    expected = "command is vx m/s, vy m/s and yaw rate rad/s, to the left positive"
    remedy = f"{expected}: correct what writes the log, or delete channels.command in the mapping"
    for factors, words in (
        ((1.0, 1.0, np.pi / 180), "the yaw rate of command taken as deg/s"),
        ((1.0, 1.0, -1.0), "the yaw rate of command counted the other way"),
        ((1.0, -1.0, 1.0), "the sideways speed of command counted the other way"),
        ((1.0, -1.0, -1.0), "the sideways speed and yaw rate of command counted the other way"),
    ):
        yield Reading({"command": _columns(range(3), factors)}, words, remedy)


def _columns(order: Sequence[int], factors: Sequence[float] | None = None) -> Change:
    """Columns in another order, times factors."""

    def change(values: np.ndarray) -> np.ndarray:
        taken = values[:, list(order)]
        return taken if factors is None else taken * np.asarray(factors, values.dtype)

    return change


def _middle(recording: Recording) -> Recording:
    """At most MOST_SAMPLES of it."""
    total = recording.num_samples
    first = max(0, (total - MOST_SAMPLES) // 2)
    if first == 0:
        return recording
    cut = slice(first, first + MOST_SAMPLES)
    channels = {name: Series(series.channel, series.values[cut]) for name, series in recording.channels.items()}
    return recording.replace(time=recording.time[cut], channels=channels)
