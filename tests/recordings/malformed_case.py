"""A whole log and its mapping, for a kind to spoil; and the tables that kinds put themselves into."""

from __future__ import annotations

import random
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

ROWS = 120
NAMES = ("t", "H_tau", "K_tau", "amps")


@dataclass
class Case:
    """files: to import; mapping: text of the mapping; both as the kind spoiled them."""

    folder: Path
    chance: random.Random
    rows: list[list[str]] = field(default_factory=list)
    names: list[str] = field(default_factory=lambda: list(NAMES))
    given: dict[str, Any] = field(default_factory=dict)
    text: str | bytes | None = None
    files: list[Path] = field(default_factory=list)

    def table(self) -> str:
        return "\n".join([",".join(self.names), *(",".join(row) for row in self.rows)]) + "\n"

    def write(self, content: str | bytes | None = None, name: str = "log.csv") -> Path:
        path = self.folder / name
        content = self.table() if content is None else content
        path.write_bytes(content.encode() if isinstance(content, str) else content)
        self.files = [path]
        return path

    def place(self, first: int = 5) -> int:
        return self.chance.randrange(first, len(self.rows) - 5)


def case(folder: Path, seed: int) -> Case:
    """A whole log of two joints and its mapping, of its own phase."""
    made = Case(folder, random.Random(seed))
    phase = made.chance.random()
    for step in range(ROWS):
        hip, knee = np.sin(step / 9 + phase), np.cos(step / 7 + phase)
        made.rows.append([str(1000 + 20 * step), f"{5 * hip:.4f}", f"{4 * knee:.4f}", f"{3 + hip**2:.4f}"])
    made.given = {
        "time": {"column": "t", "unit": "ms"},
        "rate_hz": 50,
        "joints": {"hip": "H", "knee": "K"},
        "channels": {
            "joint_torque": {"columns": "{joint}_tau", "unit": "N*m"},
            "draw": {"columns": "amps", "unit": "A", "idle": 1.9},
        },
    }
    return made


def columns(made: Case) -> dict[str, np.ndarray]:
    values = np.array([[float(cell) for cell in row] for row in made.rows])
    return dict(zip(made.names, values.T, strict=True))


Kind = Callable[[Case], None]
BAD: dict[str, Kind] = {}
GOOD: dict[str, Kind] = {}
EITHER: dict[str, Kind] = {}


def bad(spoil: Kind) -> Kind:
    BAD[spoil.__name__] = spoil
    return spoil


def good(spoil: Kind) -> Kind:
    GOOD[spoil.__name__] = spoil
    return spoil


def either(spoil: Kind) -> Kind:
    EITHER[spoil.__name__] = spoil
    return spoil


def ROBOT() -> Any:  # noqa: N802
    """Hip and knee: 20 N·m, 30 rad/s, ±3 rad."""
    from hts.channels import Channel
    from hts.contracts import LogOnlyRobot, RobotSpec

    limits = {"torque_limit": (20.0, 20.0), "velocity_limit": (30.0, 30.0), "position_limit": ((-3.0, 3.0),) * 2}
    spec = RobotSpec.log_only("logger", ("hip", "knee"), **limits, rate_hz=50.0)
    return LogOnlyRobot(spec, [Channel("joint_torque", "N*m", (2,))])
