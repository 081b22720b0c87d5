"""One JSON line per run: its schema, and a file of lines that a killed writer cannot spoil."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, Literal, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from hts.errors import RunError
from hts.locks import take_lock

VERSION: Literal[1] = 1
CONFIRM = "confirm"
"""The stage in which the best of all iterations walk again; among a line's `real_samples`."""
Read = TypeVar("Read", bound=BaseModel)


class Part(BaseModel):
    """Base: frozen, unknown keys refused, NaN and infinity refused."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class EverySecond(Part):
    """The same without the rule that a second must be near the asked speed; as in summary.json."""

    improvement: float
    improvement_ci95: tuple[float, float] | None = None
    mean_speed: float
    reference_mean_speed: float


class Figures(Part):
    """One speed of a head-to-head; as in summary.json. every_second: not in lines of before it was there."""

    improvement: float
    improvement_ci95: tuple[float, float] | None = None
    segments: int
    valid: float
    falls: int
    mean_speed: float
    metrics: dict[str, float] = {}
    metrics_ci95: dict[str, tuple[float, float] | None] = {}
    reference_falls: int | None = None
    reference_speed: float | None = None
    every_second: EverySecond | None = None


class Outcome(Part):
    """The final head-to-head of one objective. held: none where the speed was not held; refused: speed -> why;
    refused_falls: speed -> falls, where it fell at a refused one (not in lines of before it was kept)."""

    unit: str
    held: dict[str, Figures] | None = None
    open_loop: dict[str, Figures] | None = None
    refused: dict[str, str] = {}
    refused_falls: dict[str, int] = {}
    refused_open_loop: dict[str, str] = {}
    refused_falls_open_loop: dict[str, int] = {}


class Tried(Part):
    """A candidate that was tried in reality. predicted, measured: objective -> speed -> improvement."""

    id: str
    iteration: int
    anchor: str
    weights: dict[str, float]
    kl_bound: float | None = Field(description="nats; none: no bound")
    kl: float
    std_ratio: float | None = Field(None, description="its sigma over its anchor's")
    sim_score: float | None = Field(description="none: its training was stopped")
    sim_falls: int
    predicted: dict[str, dict[str, float]] | None = None
    predicted_sd: dict[str, dict[str, float]] | None = None
    measured: dict[str, dict[str, float]] = {}
    falls: int = 0
    falls_again: int | None = Field(None, description="in a second trial; none: it had none, or a line of before")
    fell: bool = False
    refused: bool = False
    why: str | None = Field(None, description="why it was refused; none in lines of before it was kept")
    gate: bool | None = Field(None, description="whether it passed the gate; none: not asked, or a line of before")


class Pair(Part):
    """What a policy's measured quantity was and what the iteration's model made of its log, in the target's unit."""

    policy: str
    speed: float | None = None
    measured: float
    predicted: float


class Doubt(Part):
    """By how much a model was off in a policy's mean (predicted less measured), and the mean of the standard deviations
    that it gave, in the target's unit, over all recordings of that policy's test."""

    policy: str
    error: float
    spread: float


class Model(Part):
    """One fit of one objective's measurement model, and how it did on the policies tried after it."""

    iteration: int
    objective: str
    held_out_r2: float | None = None
    elites_r2: float | None = None
    rank_correlation: float | None = None
    proxy_rank_correlation: dict[str, float | None] = {}
    pairs: list[Pair] = []
    doubts: list[Doubt] = []


class Point(Part):
    """The best so far after an iteration. samples: real ones until then; improvement: objective -> speed -> value, when
    it was tried; final: the same measured like the final, a refused speed as 0 (`evaluation.each_iteration`)."""

    iteration: int
    samples: int
    best: str
    improvement: dict[str, dict[str, float]] = {}
    final: dict[str, dict[str, float]] | None = None


class GivenUp(Part):
    """A policy that had a final of its own beside that of the result. refused: objective -> speed -> why; error: why
    nothing could be compared."""

    policy: str
    refused: dict[str, dict[str, str]] = {}
    falls: int = 0
    error: str | None = None


class Result(Part):
    """What a finished run came to."""

    final_policy: str
    asked_speeds: list[float]
    objectives: dict[str, Outcome]
    given_up: list[GivenUp] = []
    best: Tried | None = Field(None, description="none: the pretrained policy stayed the best")
    tried: list[Tried]
    candidates: int
    stopped_candidates: int = 0
    models: list[Model] = []
    pooled_rank: dict[str, float | None] = {}
    curve: list[Point] = []
    max_real_samples: int | None = Field(None, description="the cap before the final")
    real_samples: dict[str, int] = Field(description="by stage; `total` as in summary.json")
    first_data_falls: int | None = Field(None, description="none: no first data, or a line of before it was kept")
    sim_steps: int
    seconds: dict[str, float] = Field(description="by stage; `total` as in summary.json")
    note: str | None = Field(None, description="what must be said beside these figures, as in summary.json")


class RunLine(Part):
    """One run, whatever is kept of it. key: see `methods.Job.key`. seconds_here: of the last process that worked at it,
    s."""

    version: Literal[1] = VERSION
    key: str
    status: Literal["done", "failed"]
    error: str | None = None
    batch: str
    method: str
    method_hash: str
    reality: str
    reality_hash: str
    seed: int
    preset: str
    commit: str
    arguments: list[str]
    ended: str
    seconds_here: float
    versions: dict[str, str] = {}
    hardware: dict[str, Any] = {}


class Line(RunLine):
    """One run to its end."""

    result: Result | None = None


OfRun = TypeVar("OfRun", bound=RunLine)


def read_lines(paths: Iterable[Path]) -> list[Line]:
    """Lines of runs in these files; see `latest`."""
    return latest(paths, Line, f"version {VERSION}, as benchmarks/realities.py run writes it")


def latest(paths: Iterable[Path], kind: type[OfRun], expected: str) -> list[OfRun]:
    """Lines of these files, a later one of a key in place of an earlier one. Raises RunError naming file and line.

    What a killed writer left of a last line is not a line; one that lacks no more than its newline is.
    """
    found: dict[str, OfRun] = {}
    for line in parsed(paths, kind, expected):
        if line.status == "done" or line.key not in found or found[line.key].status == "failed":
            found.pop(line.key, None)
            found[line.key] = line
    return list(found.values())


def parsed(paths: Iterable[Path], kind: type[Read], expected: str) -> Iterator[Read]:
    """Every whole line of these files as that kind. Raises RunError naming file and line."""
    for path in paths:
        for number, text in enumerate(_whole(path.read_bytes()).split(b"\n")[:-1], start=1):
            try:
                yield kind.model_validate_json(text)
            except ValidationError as error:
                first = error.errors(include_url=False)[0]
                where = ".".join(str(part) for part in first["loc"]) or "the line"
                raise RunError(
                    f"{path}, line {number}: {where}: {first['msg']}. Expected a line of {expected}. Take the file as "
                    "it was committed, or run again."
                ) from error


def files_of(places: Sequence[Path]) -> list[Path]:
    """Files of lines in these places: a file itself, of a folder its *.jsonl. Raises RunError where there is none."""
    found = [file for place in places for file in (sorted(place.glob("*.jsonl")) if place.is_dir() else [place])]
    missing = [file for file in found if not file.is_file()]
    if missing:
        raise RunError(f"{missing[0]}: there is no such file. Expected lines of benchmarks/realities.py run.")
    return found


def append(path: Path, line: Part) -> None:
    """Add a line; it is on the disk when this returns. Several processes may write one file."""
    text = (line.model_dump_json() + "\n").encode("utf-8")
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("a+b") as file:
        take_lock(file, wait=True)
        file.seek(0)
        content = file.read()
        whole = _whole(content)
        if len(whole) < len(content):  # a writer was killed in the midst of its line; that run is made again
            file.truncate(len(whole))
        file.write(whole[len(content) :] + text)
        file.flush()
        os.fsync(file.fileno())


def _whole(content: bytes) -> bytes:
    """Its whole lines, each with its newline: what follows the last one is a line if it is whole JSON, as no part of a
    torn object is."""
    end = content.rfind(b"\n") + 1
    try:
        json.loads(content[end:])
    except (ValueError, RecursionError):
        return content[:end]
    return content + b"\n"
