"""Which stage a run is in, as its folder and its own lines say it."""

from __future__ import annotations

import json
from pathlib import Path

import yaml

OF_AN_ITERATION = ("fit", "finetune", "simulate", "gate", "test")
IN_THE_WORLD = ("collect", "test", "final")
KINDS = ("collect", "fit", "finetune", "simulate", "gate", "test", "final")


def iterations(run: Path) -> int:
    """How many the run has."""
    return int(yaml.safe_load((run / "config.yaml").read_text())["iterations"])


def names(run: Path) -> list[str]:
    """All stages that are killed and timed, in order; `nearer` where there was one."""
    inside = []
    for index in range(iterations(run)):
        folder = f"iterations/{index:02d}"
        inside += [f"{folder}/{kind}" for kind in OF_AN_ITERATION]
        if (run / folder / "nearer.json").exists():
            inside.insert(len(inside) - 1, f"{folder}/nearer")
    return ["collect", *inside, "final"]


def current(run: Path) -> str | None:
    """The first stage that has no result; None if all have one, or nothing has begun."""
    if not (run / "config.yaml").exists():
        return None
    return next((name for name in names(run) if not (run / f"{name}.json").exists()), None)


def kind_of(name: str) -> str:
    """The kind of a stage: `fit` of iterations/01/fit."""
    return name.rsplit("/", 1)[-1]


def seconds(run: Path) -> dict[str, float]:
    """Of the finished stages."""
    path = run / "log" / "stages.json"
    return json.loads(path.read_text()) if path.exists() else {}


def begins(line: str) -> bool:
    """Whether a line of `hts run` says that a stage begins: "[2/9] title"; its end has the seconds behind a colon."""
    return line.startswith("[") and "/" in line.split("]")[0] and not line.rstrip().endswith(" s")


def stamps(run: Path) -> dict[str, list[int]]:
    """Results of finished stages: name -> inode and time of writing, which change if a stage is done again."""
    found = {}
    for name in names(run) if (run / "config.yaml").exists() else []:
        path = run / f"{name}.json"
        if path.exists():
            found[name] = [path.stat().st_ino, path.stat().st_mtime_ns]
    return found


def recordings(run: Path) -> int:
    """How many the run's store holds."""
    store = run / "data.zarr"
    return sum(one.is_dir() and not one.name.startswith(".") for one in store.iterdir()) if store.exists() else 0
