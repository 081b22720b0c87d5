"""Draws side by side until enough agree with the facts; written as they come, so that it goes on where it stopped.

    DIR/draws.jsonl     first line: what was asked; then one line a draw, in the order of the index, kept or not
    DIR/NAME-00.json    the realities that were kept

The result follows from seed and count alone: draws are looked at in the order of their index, whoever is done first.
"""

from __future__ import annotations

import json
import tempfile
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Future
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from hts import plugins
from hts.atomic import atomic_write
from hts.cores import available
from hts.errors import ConfigError
from hts.explain import dotted, explain
from hts.plugin_settings import in_full
from hts.worlds.realities.check import Tried, Verdict, check, fallen_at
from hts.worlds.realities.draw import Draw, draw
from hts.worlds.realities.folder import LINES, begun, only_one
from hts.worlds.realities.ranges import drawn_parameters, instruments_in, ranges_sha256
from hts.worlds.realities.workers import worker_processes
from hts.worlds.twin.parameters import MACHINE, TwinSettings
from hts.worlds.twin.reality import Reality, read

AHEAD = 2  # draws in work per process: one that takes long does not hold up the others

Told = Callable[[Mapping[str, Any], str], None]


@dataclass(frozen=True)
class Asked:
    """What to draw: so many realities of a robot from a seed, called NAME-00 and so on."""

    count: int
    seed: str
    robot: str
    name: str
    policy: str  # exported


def parameters_of(drawn: Draw, registry: plugins.Registry) -> dict[str, dict[str, Any]]:
    """All parameters of the twin in full, with those that were drawn."""
    settings = TwinSettings.model_validate(drawn.nested())
    content: dict[str, dict[str, Any]] = settings.model_dump(mode="json", include=set(MACHINE))
    for name, given in settings.instruments.items():
        content["instruments"][name] = in_full(registry, "instruments", name, given)
    return content


def machine_of(reality: Reality) -> Tried:
    """The twin. Raises ConfigError for parameters that it or its instruments do not take."""
    registry = plugins.load()
    robot = registry.make_robot(reality.robot)
    settings = _settings_of(reality)
    instruments = {name: registry.make_instrument(name, given, robot) for name, given in settings.instruments.items()}
    return Tried(robot, settings, instruments)


def read_whole(reference: str) -> Reality:
    """What is in the file of a name or path, all of which a twin takes. Raises ConfigError that names it."""
    reality = read(reference)
    try:
        machine_of(reality)
    except ConfigError as error:
        raise ConfigError(f"reality {reference}: {error}") from error
    return reality


def read_to_show(reference: str) -> tuple[Reality, str]:
    """As `read_whole`; and where its robot or an instrument is not installed here, what could not be checked for that,
    one line, else "". Raises ConfigError."""
    reality, registry = read(reference), plugins.load()
    named = {f"robot '{reality.robot}'": reality.robot in registry.robots}
    for name in reality.parameters.get("instruments", {}):
        named[f"instrument '{name}'"] = name in registry.offered("instruments")
    absent = [what for what, there in named.items() if not there]
    if not absent:
        return read_whole(reference), ""
    try:
        _settings_of(reality)
    except ConfigError as error:
        raise ConfigError(f"reality {reference}: {error}") from error
    return reality, (
        f"Not installed here: {', '.join(absent)}. Shown is what the file says; whether a twin takes all of it was not "
        "checked. Install the package that brings it, or see `hts plugins` why it does not load."
    )


def _settings_of(reality: Reality) -> TwinSettings:
    """The twin's own settings. Raises ConfigError for what it does not take."""
    try:
        return TwinSettings.model_validate(dict(reality.parameters))
    except ValidationError as error:
        raise ConfigError(explain(error, TwinSettings, lambda at: f"parameters.{dotted(at)}")) from error


def examine(reality: Reality, policy: Path) -> Verdict:
    """Hold a reality against the facts."""
    return check(machine_of(reality), policy)


def one_draw(asked: Asked, index: int) -> tuple[dict[str, Any], str]:
    """The line of a draw, and the reality's file if it is kept ("" if not). Its name is still to be filled in."""
    registry = plugins.load()
    drawn = draw(drawn_parameters(registry), asked.seed, index)
    reality = Reality(
        name="",
        robot=asked.robot,
        seed=asked.seed,
        index=index,
        switches=drawn.switches,
        parameters=parameters_of(drawn, registry),
    )
    verdict = examine(reality, Path(asked.policy))
    line = {
        "index": index,
        "kept": verdict.kept,
        "why": verdict.why,
        "switches": list(drawn.switches),
        **({"values": dict(drawn.values)} if verdict.kept else {}),  # those of the others follow from the seed
        "measured": {one.name: round(one.value, 4) for one in verdict.measured},
    }
    whole = reality.model_copy(update={"facts": verdict.measured})
    return line, whole.model_dump_json() if verdict.kept else ""


def draw_many(
    asked: Asked,
    folder: Path,
    processes: int = 0,
    tell: Told | None = None,
    first: Callable[[], None] | None = None,
) -> list[Path]:
    """Files of the realities that were kept, as many as asked for. Goes on with what the folder holds already; first:
    called where it holds no draw."""
    parameters = drawn_parameters(plugins.load())
    heading = {
        "format": 1,
        "seed": asked.seed,
        "robot": asked.robot,
        "name": asked.name,
        "ranges_sha256": ranges_sha256(parameters),
    }
    with only_one(folder):
        lines = begun(folder, heading, instruments_in(parameters))
        files = [folder / f"{asked.name}-{number:02d}.json" for number in range(asked.count)]
        kept = sum(line["kept"] for line in lines)
        for there in files[:kept]:
            read(str(there))  # raises for one that is not there or broken
        if kept >= asked.count:
            return files
        if first is not None and not lines:
            first()
        for line, content in _in_order(asked, len(lines), processes):
            path = files[kept] if line["kept"] else None
            if path is not None:
                named = Reality.model_validate_json(content).model_copy(update={"name": path.stem})
                atomic_write(path, json.dumps(named.model_dump(mode="json"), indent=1) + "\n")
                kept += 1
            with (folder / LINES).open("a", encoding="utf-8") as file:
                file.write(json.dumps(line) + "\n")
            if tell is not None:
                tell(line, path.stem if path else "")
            if kept == asked.count:
                break
        return files


def _in_order(asked: Asked, first: int, processes: int) -> Iterator[tuple[dict[str, Any], str]]:
    """Draws from `first` on, without end, in the order of the index."""
    number = processes or available()
    with worker_processes(number) as pool:
        waiting: list[Future[tuple[dict[str, Any], str]]] = []
        index = first
        while True:
            while len(waiting) < AHEAD * number:
                waiting.append(pool.submit(one_draw, asked, index))
                index += 1
            yield waiting.pop(0).result()


def exported_policy(robot: str, folder: Path, source: Path | None = None) -> Path:
    """The policy that the robot's package ships, or that of a file, as ONNX in the folder. Raises ConfigError if there
    is none."""
    from hts.policies.export import to_onnx
    from hts.policies.files import load_policy

    source = source or plugins.load().make_robot(robot).pretrained_policy()
    if source is None or not Path(source).exists():
        raise ConfigError(f"Robot '{robot}' ships no policy, so no draw can be held against how it walks.")
    return to_onnx(load_policy(Path(source)), folder / "pretrained.onnx")


def check_walks(robot: str, policy: Path) -> None:
    """Before the first draw: raises ConfigError where the policy (ONNX) falls on the default twin already, so that
    draws would be dropped without end."""
    registry = plugins.load()
    machine = registry.make_robot(robot)
    instruments = {name: registry.make_instrument(name, {}, machine) for name in registry.offered("instruments")}
    speeds, fell = fallen_at(machine, instruments, policy)
    if fell:
        walks = ", ".join(f"{speed:g}" for speed in speeds)
        raise ConfigError(
            f"Robot '{robot}': its policy {fell} on the default twin. A draw is kept if it walks at {walks} m/s and "
            "agrees with what is published of the machine, so none would be. Draw what agrees with recordings of "
            "yours, at the speeds that they hold (--like STORE), or start from a policy that walks there."
        )


def verdict_on(reality: Reality) -> Verdict:
    """Hold a reality against the facts, with its robot's own policy."""
    with tempfile.TemporaryDirectory() as folder:
        return examine(reality, exported_policy(reality.robot, Path(folder)))
