"""What every world needs: a schedule as commands per control step, and an operator who keeps the heading."""

from __future__ import annotations

import hashlib
import itertools
import json
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from hts.config import Command, ScheduleConfig

if TYPE_CHECKING:
    from hts.recordings.recording import Recording

HEADING_GAIN = 0.5  # rad/s per rad, as the training commands of Rudin et al. 2022 as released
LARGEST_YAW_RATE = 1.0  # rad/s
ORDER = ("reference", "policy", "policy", "reference")
"""Roles of the blocks of a head-to-head: A-B-B-A cancels a drift that is linear in time."""


def round_order(policies: int, number: int) -> list[int | None]:
    """Who walks in the blocks of a round: index of a policy, or None for the reference. Each twice, there and back.

    A-B-C-C-B-A: everybody has the same mean time, so a drift that is linear in time cancels as in A-B-B-A, and each
    half holds one block of everybody. Who begins moves on from round to round: what a block leaves to the next
    (warm motors) then falls on others.
    """
    walkers: list[int | None] = [None, *range(policies)]
    first = number % len(walkers)
    there = walkers[first:] + walkers[:first]
    return there + there[::-1]


def shared_out(recordings: Sequence[Recording], order: Sequence[int | None], policies: int) -> list[list[Recording]]:
    """One list a policy from the blocks of a round, at one speed or at several one after the other: its own and the
    reference's, in the order of time."""
    blocks = list(zip(recordings, itertools.cycle(order), strict=False))
    return [[recording for recording, who in blocks if who in (None, policy)] for policy in range(policies)]


def commands(schedule: ScheduleConfig, rate_hz: float) -> np.ndarray:
    """Commanded vx m/s, vy m/s, yaw rate rad/s at each control step, (T, 3). T = round(seconds * rate_hz)."""
    rows = []
    elapsed, done = 0.0, 0
    for command in schedule.commands:
        elapsed += command.seconds
        steps = round(elapsed * rate_hz) - done  # rounded in total, so that many short commands do not drift
        done += steps
        rows.append(np.tile([command.vx, command.vy, command.yaw_rate], (steps, 1)))
    return np.concatenate(rows)


def walking(speed: float, seconds: float) -> ScheduleConfig:
    """Straight ahead at one speed, m/s, for so long, s."""
    return ScheduleConfig(commands=(Command(seconds=seconds, vx=speed),))


class Operator:
    """Keeps the heading of W robots as a person with a joystick would.

    While a robot is commanded to walk without turning, yaw rate = clip(0.5 * heading error, -1, 1); the heading to keep
    is the one it had when that began. A robot commanded to stand still gets no correction. gain: factor on 0.5;
    offset: by how much the operator misjudges a heading, rad; both (W,) or a number.
    """

    def __init__(self, num_worlds: int, gain: np.ndarray | float = 1.0, offset: np.ndarray | float = 0.0) -> None:
        self._gain, self._offset = HEADING_GAIN * gain, offset
        self._wanted = np.zeros(num_worlds)
        self._keeping = np.zeros(num_worlds, dtype=bool)

    def command(self, commanded: np.ndarray, heading: np.ndarray) -> np.ndarray:
        """What is sent to the robots, (W, 3). commanded: of the schedule (W, 3) or (3,); heading: rad (W,)."""
        sent = np.empty((len(heading), 3))
        sent[:] = commanded
        straight = (sent[:, 2] == 0) & ((sent[:, 0] != 0) | (sent[:, 1] != 0))
        begins = straight & ~self._keeping
        np.copyto(self._wanted, heading, where=begins)
        self._keeping = straight
        error = (self._wanted + self._offset - heading + np.pi) % (2 * np.pi) - np.pi
        correction = np.minimum(np.maximum(self._gain * error, -LARGEST_YAW_RATE), LARGEST_YAW_RATE)
        np.copyto(sent[:, 2], correction, where=straight)
        return sent

    def forget(self, mask: np.ndarray) -> None:
        """A new heading to keep for the robots of the mask (W,)."""
        self._keeping[mask] = False


def request_id(*parts: Any) -> str:
    """12 hex digits that name a request by its content, so that repeating it gives the same session names and noise."""
    return hashlib.sha256(json.dumps(parts, sort_keys=True, default=str).encode()).hexdigest()[:12]


def seed_sequence(seed: int, request: str, group: int = 0) -> np.random.SeedSequence:
    """Randomness of a request: from the run's seed and the request's content, not from how many came before."""
    return np.random.SeedSequence([seed, int(request, 16), group])


def in_groups(count: int, largest: int) -> list[range]:
    """0..count-1 cut into groups of nearly equal size, at most `largest`, and at least two groups where possible.

    It must not depend on the machine: which robots share a group decides which noise they get.
    """
    number = min(count, max(2, -(-count // largest)))
    edges = [round(i * count / number) for i in range(number + 1)] if number else [0]
    return [range(a, b) for a, b in itertools.pairwise(edges)]


def file_hash(path: Any) -> str:
    """SHA-256 of a file's content, for naming requests."""
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
