"""A run folder that the world `field` works in, and logs as a robot would write them."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import yaml

from hts.contracts import HoldSpeed, WorldContext
from hts.worlds.field import make_field

SECONDS = 3.0
HOLD = HoldSpeed((0.4, 1.2))


def field(run: Path, **settings):
    context = WorldContext("go1", {}, {"power": {}}, 0, run)
    return make_field({"block_seconds": SECONDS, **settings}, context)


def holding(run: Path, **settings):
    world = field(run, **settings)
    assert world.hold_speed(HOLD)
    return world


def write_log(path: Path, robot, seconds: float = SECONDS, command: float | np.ndarray | None = None) -> None:
    """A log whose columns are named as the template names them. command: forward, m/s; None: as asked."""
    rng, steps = np.random.default_rng(list(str(path)[-30:].encode())), round(seconds * 50)  # no two rows are alike
    columns: dict[str, np.ndarray] = {"time": np.arange(steps) / 50}
    for name, channel in robot.channels().items():
        for i in range(channel.shape[0]):
            centre = robot.spec.default_pose[i] if name in ("joint_position", "joint_target") else 0.0
            label = (
                f"{robot.spec.joint_names[i]}_{name.removeprefix('joint_')}"
                if name.startswith("joint_")
                else f"{name}_{i}"
            )
            columns[label] = centre + 0.05 * rng.standard_normal(steps)
    gravity = [columns[f"projected_gravity_{i}"] for i in range(3)]
    gravity[2] -= 1.0
    length = np.sqrt(sum(part**2 for part in gravity))
    for i, part in enumerate(gravity):
        columns[f"projected_gravity_{i}"] = part / length
    columns["command_0"] = np.broadcast_to(as_asked(path, steps) if command is None else command, steps)
    columns["battery_voltage"] = 22.0 + 0.1 * rng.standard_normal(steps)
    columns["battery_current"] = 5.0 + 0.1 * rng.standard_normal(steps)
    rows = np.stack(list(columns.values()), axis=1)
    np.savetxt(path, rows, delimiter=",", header=",".join(columns), comments="", fmt="%.6f")


def as_asked(log: Path, steps: int) -> np.ndarray:
    """Forward commands of a row, m/s: those of the bundle that the log lies in, the last one until the end."""
    plan = json.loads((log.parent.parent / "plan.json").read_text())
    (row,) = [row for row in plan if row["log"] == log.stem]
    asked = [np.full(round(one["seconds"] * 50), one["vx"]) for one in row["schedule"]["commands"]]
    return np.resize(np.concatenate([*asked, np.full(steps, asked[-1][-1])]), steps)


def bundle(run: Path) -> Path:
    return next(path for path in (run / "field").iterdir() if path.is_dir())


def fill_in(run: Path) -> None:
    path = run / "field" / "mapping.yaml"
    mapping = yaml.safe_load(path.read_text())
    mapping["channels"]["battery_current"]["idle"] = 1.3
    mapping["channels"]["battery_voltage"]["idle"] = 23.0
    mapping["recording"]["mass_kg"] = 13.2
    path.write_text(yaml.safe_dump(mapping))
