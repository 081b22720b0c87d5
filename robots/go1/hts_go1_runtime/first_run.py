"""How a policy that never ran on this robot is walked first: slowly, with less torque, nothing recorded."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from hts_go1_runtime.bundle import Row


@dataclass(frozen=True)
class FirstRun:
    """As the manifest says. speed_scale: of each commanded speed; torque_scale: of each torque limit; seconds: of a
    policy."""

    speed_scale: float
    torque_scale: float
    seconds: float

    @classmethod
    def of(cls, manifest: Mapping[str, Any]) -> FirstRun:
        said = manifest["first_runs"]
        return cls(float(said["speed_scale"]), float(said["torque_scale"]), float(said["seconds"]))

    def commands(self, rows: Sequence[Row], policy: str) -> list[tuple[float, float, float, float]]:
        """(seconds, vx m/s, vy m/s, yaw rate rad/s), one after the other: every command of the policy's rows, scaled,
        the slowest first, each for its share of the time."""
        asked = {command[1:] for row in rows if row.policy == policy for command in row.commands}
        rising = sorted(asked, key=lambda one: (one[0] ** 2 + one[1] ** 2, abs(one[2]), one))
        share = self.seconds / len(rising)
        scale = self.speed_scale
        return [(share, scale * vx, scale * vy, scale * turn) for vx, vy, turn in rising]
