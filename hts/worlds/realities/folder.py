"""A folder of draws: its lines, whole and in their order, and that one command at a time adds to them."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hts import locks
from hts.atomic import atomic_write, temporary_of
from hts.errors import ConfigError, RunError
from hts.places import check_place
from hts.worlds.realities.sampler import Particle

LINES = "draws.jsonl"
LOCK = ".lock"


@dataclass(frozen=True)
class Draws:
    """heading: what was asked for; lines: one a draw, or a particle of a population."""

    heading: Mapping[str, Any]
    lines: list[dict[str, Any]]


def check_name(name: str, folder: Path) -> None:
    """Raise ConfigError or RunError unless realities NAME-00 and so on can be files of the folder."""
    if not name or name.startswith(".") or not name.isprintable() or {"/", "\\"} & set(name):
        raise ConfigError(f"--name {name!r}: expected a part of a file's name, without / or \\ and no dot first.")
    check_place(folder / f"{name}-00.json", "--out DIR and --name NAME", file=True)


@contextmanager
def only_one(folder: Path) -> Iterator[None]:
    """Nobody else draws into the folder meanwhile; it is made. Raises RunError where somebody does, or where the folder
    holds other things."""
    _check_free(folder)
    folder.mkdir(parents=True, exist_ok=True)
    busy = f"{folder}: another process draws into it. Wait for it, or choose another folder with --out."
    with locks.only_one(folder / LOCK, busy):
        yield


def begun(folder: Path, heading: Mapping[str, Any], instruments: Sequence[str] = ()) -> list[dict[str, Any]]:
    """Lines so far of a folder with this heading, begun if it is empty. A line that was cut off is drawn again.
    instruments: that are drawn here, whose ranges are part of `ranges_sha256`. Raises RunError for a folder of others,
    or a damaged one."""
    _check_free(folder)
    path = folder / LINES
    if not path.exists():
        atomic_write(path, json.dumps(heading) + "\n")
        return []
    draws = _headed(path)
    found = draws.heading
    other = [key for key in {**heading, **found} if found.get(key) != heading.get(key)]
    if "like" in other:
        had = "other figures of a robot, or another --discrepancy" if "like" in found else "the public facts"
        raise RunError(f"{path}: was begun with {had}. Choose another folder with --out.")
    if "ranges_sha256" in other:
        raise RunError(
            f"{path}: was begun with other ranges (ranges_sha256 {found.get('ranges_sha256')}, now "
            f"{heading.get('ranges_sha256')}): of another version, or with other instruments than are installed here, "
            f"{', '.join(instruments) or 'none'}. Go on where it was begun, or choose another folder with --out."
        )
    if other:
        raise RunError(
            f"{path}: was begun with another {other[0]} ({found.get(other[0])}, now {heading.get(other[0])}). "
            "Choose another folder with --out."
        )
    _check_lines(path, draws)
    data = path.read_bytes()
    whole = data[: data.rfind(b"\n") + 1]
    if whole != data:
        atomic_write(path, whole)
    return draws.lines


def draws_of(folder: Path) -> Draws:
    """What the folder holds, whole lines alone. Raises RunError for one that holds none, or a damaged one."""
    path = folder / LINES
    if not path.is_file():
        raise RunError(f"{path}: there is no such file. `hts realities draw` writes it.")
    draws = _headed(path)
    _check_lines(path, draws)
    return draws


def rows_of(path: Path) -> list[dict[str, Any]]:
    """JSON objects, one a whole line. Raises RunError for a line that is none."""
    data = path.read_bytes()
    rows = []
    for number, line in enumerate(data[: data.rfind(b"\n") + 1].splitlines(), 1):
        try:
            row = json.loads(line.decode("utf-8"))
        except (UnicodeDecodeError, json.JSONDecodeError, RecursionError) as error:
            raise damaged(path, number, f"no JSON: {error}") from error
        if not isinstance(row, dict):
            raise damaged(path, number, f"expected keys and values, found {type(row).__name__}")
        rows.append(row)
    return rows


def damaged(path: Path, line: int, why: str) -> RunError:
    """The error for a line that nothing can be made of."""
    return RunError(
        f"{path}: line {line} is damaged ({why}). Put the file back, or draw anew: `hts realities draw` with another "
        "--out."
    )


def _check_free(folder: Path) -> None:
    """It is one of draws, or nothing is in it."""
    if (folder / LINES).exists() or not folder.is_dir():
        return
    if {path.name for path in folder.iterdir()} - {LOCK, temporary_of(Path(LINES)).name}:
        raise RunError(f"{folder}: is not empty and holds no {LINES}. Choose an empty folder with --out.")


def _headed(path: Path) -> Draws:
    rows = rows_of(path)
    if not rows:
        raise damaged(path, 1, "expected what was asked for, found nothing")
    return Draws(rows[0], rows[1:])


def _check_lines(path: Path, draws: Draws) -> None:
    """They are what draws are, and in their order: two commands at once, or a hand, would leave others."""
    size = draws.heading.get("size") if "like" in draws.heading else None
    if "like" in draws.heading and not (isinstance(size, int) and size > 0):
        raise damaged(path, 1, f"size: expected a whole number above 0, found {size!r}")
    for number, line in enumerate(draws.lines):
        try:
            if size is None:
                _ = line["why"], line["values"] if line["kept"] else None
                found, expected = f"draw {line['index']}", f"draw {number}"
            else:
                _ = line["bound"], line["step"], Particle.of(line)
                generation, place = divmod(number, size)
                found = f"place {line['place']} of generation {line['generation']}"
                expected = f"place {place} of generation {generation}"
        except KeyError as error:
            raise damaged(path, number + 2, f"without {error}") from error
        except (TypeError, ValueError) as error:
            raise damaged(path, number + 2, str(error)) from error
        if found != expected:
            raise damaged(path, number + 2, f"expected {expected}, found {found}")
