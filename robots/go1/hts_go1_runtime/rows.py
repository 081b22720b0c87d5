"""The rows of a deploy bundle: one log each, recorded in their order."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from hts_go1_runtime.errors import RuntimeFault
from hts_go1_runtime.policy import Policy

LONGEST_ROW = 3600.0  # s
FASTEST, FASTEST_TURN = 3.0, 3.0  # m/s, rad/s: no command for this robot


@dataclass(frozen=True)
class Row:
    """One log to be recorded. commands: (seconds, vx m/s, vy m/s, yaw rate rad/s) one after the other."""

    log: str
    policy: str
    policy_hash: str
    session: str
    block: int
    role: str
    trim: bool
    commands: tuple[tuple[float, float, float, float], ...]

    @property
    def seconds(self) -> float:
        return sum(command[0] for command in self.commands)


def row_of(row: Mapping[str, Any], policies: Mapping[str, Policy], where: str) -> Row:
    """A row of the manifest. Raises RuntimeFault for one that no robot may walk."""
    name = str(row["log"])
    if not name or not all(sign.isalnum() or sign in "-_" for sign in name):
        raise RuntimeFault(f"{where}: a row's log is called '{name}', expected letters and digits.")
    if row["policy"] not in policies:
        raise RuntimeFault(f"{where}: row {name} wants {row['policy']}, which is no policy of the bundle.")
    if row["policy_hash"] != policies[row["policy"]].entry["policy_hash"]:
        raise RuntimeFault(f"{where}: row {name} wants another policy_hash than {row['policy']} has.")
    asked = (
        [float(one.get(key, 0.0)) for key in ("seconds", "vx", "vy", "yaw_rate")] for one in row["schedule"]["commands"]
    )
    commands = tuple((seconds, vx, vy, turn) for seconds, vx, vy, turn in asked)
    for seconds, vx, vy, turn in commands:
        sane = 0 < seconds <= LONGEST_ROW and max(abs(vx), abs(vy)) <= FASTEST and abs(turn) <= FASTEST_TURN
        if not sane or not all(map(math.isfinite, (seconds, vx, vy, turn))):
            raise RuntimeFault(f"{where}: row {name} commands {vx:g}, {vy:g} m/s, {turn:g} rad/s for {seconds:g} s.")
    if not commands:
        raise RuntimeFault(f"{where}: row {name} commands nothing.")
    return Row(
        log=name,
        policy=str(row["policy"]),
        policy_hash=str(row["policy_hash"]),
        session=str(row["session"]),
        block=int(row["block"]),
        role=str(row["role"]),
        trim=bool(row["trim"]),
        commands=commands,
    )


def steps_of(commands: Sequence[tuple[float, float, float, float]], rate_hz: float) -> np.ndarray:
    """Commands of each control step, (T, 3); T = round(seconds * rate), rounded in total as the twin does."""
    rows, elapsed, done = [], 0.0, 0
    for seconds, *command in commands:
        elapsed += seconds
        steps = round(elapsed * rate_hz) - done
        done += steps
        rows.append(np.tile(np.array(command, float), (steps, 1)))
    return np.concatenate(rows)
