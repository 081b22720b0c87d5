"""A reality in a file: one complete set of a twin's parameters and structures, by path or by name.

A run names it, `world.reality`, and keeps the name and the file's SHA-256. Only the twin's own process reads what is
in it. Names are those of files in folders `realities` of the packages that bring robots:
`hts_NAME/realities/dev-03.json` is `dev-03`.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from importlib import import_module
from pathlib import Path
from typing import Any

from pydantic import Field, ValidationError

from hts.config import Config
from hts.config_base import NameOrFile
from hts.errors import ConfigError, UnfitWorldError, unknown_name
from hts.explain import explain
from hts.worlds.base import file_hash

FOLDER, SUFFIX = "realities", ".json"
REFERENCE = NameOrFile(SUFFIX)

OTHERS: Mapping[str, set[str]] = {
    "the card of a policy": {"joint_names", "observation", "control_rate_hz"},
    "the card of a measurement model": {"format", "sha256", "notes"},
    "the summary of a run": {"objectives", "final", "iterations"},
    "the provenance of a run": {"packages", "hardware"},
    "what was asked of a pretraining": {"robot", "config"},
}
"""Files that hts writes, and keys that tell them from a reality."""
WHERE_FROM = "`hts realities list` names those that are installed, `hts realities draw` makes files of others."


class Measured(Config):
    """A public fact that was checked when the reality was drawn."""

    name: str = Field(description="of the fact, as the robot calls it")
    value: float = Field(description="what this reality shows, in `unit`")
    low: float = Field(description="lowest value that agrees with the source")
    high: float = Field(description="highest value that agrees with the source")
    unit: str = Field(description="of all three")


class Reality(Config):
    """What is in the file."""

    format: int = Field(1, ge=1, le=1, description="of the file")
    name: str = Field(description="of the reality, and of its file without the ending")
    robot: str = Field(description="as registered")
    seed: str = Field(description="text that it was drawn from")
    index: int = Field(ge=0, description="of the draw")
    switches: tuple[str, ...] = Field(description="structures that are on")
    parameters: dict[str, dict[str, Any]] = Field(description="dynamics, sensors, sessions, instruments, in full")
    facts: tuple[Measured, ...] = Field((), description="public facts that it was checked by")


def known_names() -> dict[str, Path]:
    """Realities that come with installed robots, name -> file."""
    from hts import plugins

    found: dict[str, Path] = {}
    packages = {entry.factory.__module__.partition(".")[0] for entry in plugins.load().robots.values()}
    for package in sorted(packages):
        for place in vars(import_module(package)).get("__path__", ()):  # a module that is no package has none
            found |= {path.stem: path for path in sorted((Path(place) / FOLDER).glob("*" + SUFFIX))}
    return found


def locate(reference: str) -> Path:
    """The file of a name or path. Raises ConfigError."""
    if REFERENCE.is_file(reference):
        path = Path(reference)
        if not path.is_file():
            looked_for = "" if path.is_absolute() else f", looked for as {path.absolute()}"
            raise ConfigError(
                f"reality {reference}: there is no such file{looked_for}. A run that was begun "
                "needs its own: put it there, or where it lies into world.reality in the run's config.yaml. For a new "
                "run draw some: `hts realities draw --count 4 --seed S --out DIR`."
            )
        return path
    names = known_names()
    if reference not in names:
        raise ConfigError(unknown_name("reality", reference, names) + f" A file's path ends in {SUFFIX}.")
    return names[reference]


def sha256(path: Path) -> str:
    """Of the file's bytes."""
    try:
        return file_hash(path)
    except OSError as error:
        raise ConfigError(f"reality {path}: cannot be read ({error.strerror}).") from error


def read(reference: str, expected_sha256: str | None = None) -> Reality:
    """What is in the file of a name or path. Raises ConfigError, also for a file that is not the one it was."""
    path = locate(reference)
    found = sha256(path)
    if expected_sha256 is not None and found != expected_sha256:
        raise ConfigError(changed(reference, found, expected_sha256))
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        if not isinstance(content, dict):
            raise ConfigError(
                f"reality {path}: expected keys and values, found a {type(content).__name__}. {WHERE_FROM}"
            )
        if other := kind_of(content):
            raise ConfigError(f"reality {path}: is {other}, expected a reality. {WHERE_FROM}")
        return Reality.model_validate(content)
    except (UnicodeDecodeError, json.JSONDecodeError) as error:
        raise ConfigError(f"reality {path}: is not JSON ({error}). {WHERE_FROM}") from error
    except ValidationError as error:
        raise ConfigError(explain(error, Reality, lambda location: f"reality {path}")) from error


def kind_of(content: Mapping[str, Any]) -> str:
    """What else a file is, by the keys that only such a file has; empty where nobody knows."""
    for kind, keys in OTHERS.items():
        if keys <= content.keys():
            robot = content.get("robot")
            return f"{kind} for robot '{robot}'" if isinstance(robot, str) else kind
    return ""


def changed(reference: str, found: str, expected: str) -> str:
    """One line about a file that is another one now."""
    return (
        f"reality {reference}: its SHA-256 is {found[:12]}…, the run was begun with {expected[:12]}…. "
        "Put the file back, or begin a new run."
    )


def for_robot(reality: Reality, robot: str) -> Mapping[str, Any]:
    """Its parameters. Raises UnfitWorldError if it is a reality of another robot."""
    if reality.robot != robot:
        raise UnfitWorldError(f"reality {reality.name}: is one of robot '{reality.robot}', the run's is '{robot}'.")
    return reality.parameters
