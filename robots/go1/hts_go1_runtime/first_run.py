"""How a policy that never ran on this robot is walked first: slowly, with less torque, nothing recorded."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from hts_go1_runtime.bundle import Bundle
from hts_go1_runtime.rows import Row

FILE = "first-runs.json"
"""In logs/: hashes of the policies that were walked so."""


def walked_before(bundle: Bundle) -> set[str]:
    """Hashes of the policies of which this bundle knows that they walked on this machine: a first run, or a log."""
    try:
        found = json.loads((bundle.logs / FILE).read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):  # nothing is known: whoever asks is told so
        found = []
    known = {one for one in found if isinstance(one, str)} if isinstance(found, list) else set()
    return known | {row.policy_hash for row in bundle.rows if (bundle.logs / f"{row.log}.csv").exists()}


def written(hashes: Iterable[str]) -> str:
    """Content of the file."""
    return json.dumps(sorted(hashes), indent=1) + "\n"


def never_walked(bundle: Bundle, rows: Sequence[Row]) -> list[str]:
    """Files of the policies of some rows that are about to walk here for the first time at full speed and torque."""
    known = walked_before(bundle)
    return list(dict.fromkeys(row.policy for row in rows if row.policy_hash not in known))


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
