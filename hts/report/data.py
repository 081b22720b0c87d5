"""What a run folder holds, read for the report. Only summary.json is needed; the rest makes the page fuller."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml
from pydantic import TypeAdapter, ValidationError

from hts.errors import RunError
from hts.explain import explain
from hts.places import resume_command
from hts.report.shapes import Evaluation, Part, Segments, Summary
from hts.report.task_words import TaskWords

Json = dict[str, Any]


@dataclass(frozen=True)
class RunData:
    """A finished run.

    summary: summary.json; config: config.yaml; provenance: provenance.json; fits: iteration -> its fit.json;
    segments: segments.json, objective -> speed -> role -> quantity -> values; evaluation: evaluation.json, made
    after the run. Those that are not there are empty.
    """

    folder: Path
    summary: Json
    config: Json
    provenance: Json
    fits: dict[int, Json]
    segments: Json
    evaluation: Json

    @property
    def world(self) -> str:
        world = self.config.get("world")
        return str(world.get("name", "unknown")) if isinstance(world, dict) else str(world or "unknown")

    @property
    def world_simulated(self) -> bool | None:
        """Whether its world computes physics; None if it does not say. Runs of before worlds said so: by its name."""
        return self.summary.get("world_simulated", {"twin": True, "field": False}.get(self.world))

    @property
    def where(self) -> str:
        """Where candidates were tried, for a sentence: no twin's number stands under a robot's name."""
        if self.world_simulated is None:
            return f"in world '{self.world}'"
        return "in simulated reality" if self.world_simulated else "in reality"

    @property
    def task(self) -> TaskWords:
        """How its set-points are called."""
        return TaskWords.of(self.summary)

    @property
    def objectives(self) -> list[str]:
        return list(self.summary.get("objectives") or self.final)

    @property
    def iterations(self) -> list[Json]:
        return list(self.summary.get("iterations") or [])

    @property
    def final(self) -> dict[str, Json]:
        """Objective -> {"unit", "speeds"} of the final head-to-head; empty if there was none."""
        return dict((self.summary.get("final") or {}).get("objectives") or {})

    @property
    def front(self) -> list[Json]:
        """Tested policies that no other beats in all objectives: [{"id", "iteration", "improvements"}]."""
        return list((self.summary.get("front") or {}).get("real") or [])

    @property
    def simulated_fronts(self) -> list[Json]:
        """The same by simulated scores, [{"iteration", "ids"}]."""
        return list((self.summary.get("front") or {}).get("simulation") or [])

    @property
    def candidates(self) -> list[Json]:
        """Of all iterations."""
        return [candidate for iteration in self.iterations for candidate in iteration.get("candidates") or []]

    @property
    def chosen(self) -> str | None:
        """The policy that is the result."""
        return (self.summary.get("final") or {}).get("policy")

    def candidate(self, name: str) -> Json:
        """A candidate by its id, {} for the pretrained policy."""
        return next((candidate for candidate in self.candidates if candidate["id"] == name), {})

    def unit(self, objective: str) -> str:
        units = (self.summary.get("front") or {}).get("units") or {}  # there is not always a final head-to-head
        return str(self.final.get(objective, {}).get("unit") or units.get(objective, "1"))

    def fit(self, index: int, objective: str) -> Json:
        """The part of an iteration's fit.json that is about this objective."""
        fit = self.fits.get(index, {})
        part = fit.get(objective, fit if len(self.objectives) == 1 else {})
        return part if isinstance(part, dict) else {}

    def tested(self, iteration: Json, objective: str) -> Iterator[tuple[Json, str, Json]]:
        """(candidate, speed, result) of every head-to-head of an iteration."""
        for candidate in iteration.get("candidates") or []:
            for speed, result in ((candidate.get("real") or {}).get(objective) or {}).items():
                yield candidate, speed, result


NO_FIT = (
    "Restore it from a backup, or delete it: the report then lacks what that iteration's models made of their logs."
)


def read_run(folder: Path) -> RunData:
    """Read a run folder. Raises RunError if there is no summary.json, or a file in it cannot be read."""
    folder = Path(folder)
    if not (folder / "summary.json").is_file():
        if (folder / "config.yaml").is_file():
            raise RunError(
                f"{folder}: this run is not finished (no summary.json). Go on with it: `{resume_command(folder)}`."
            )
        raise RunError(f"{folder}: holds no run (no summary.json). Give the folder that `hts run` named at its end.")
    summary = read_summary(folder)
    return RunData(
        folder=folder,
        summary=summary,
        config=_yaml(folder / "config.yaml"),
        provenance=_json(
            folder / "provenance.json",
            f"Restore it from a backup, since `{resume_command(folder)}` wants it too; deleted, the report says that "
            "it is not there.",
        ),
        fits={
            int(iteration["index"]): fit
            for iteration in summary.get("iterations") or []
            if (fit := _json(folder / "iterations" / f"{int(iteration['index']):02d}" / "fit.json", NO_FIT))
        },
        segments=_segments(folder / "segments.json"),
        evaluation=_shaped(
            folder / "evaluation.json",
            Evaluation,
            f"Delete it; `hts evaluate {folder}` compares anew and writes another.",
        ),
    )


def read_summary(folder: Path) -> Json:
    """summary.json of a run folder, {} if there is none. Raises RunError for one that is not what a run writes."""
    return _shaped(
        folder / "summary.json",
        Summary,
        f"If it was a finished run's, delete it and `{resume_command(folder)}`: it is written again. Else give the "
        "folder that `hts run` named at its end.",
    )


def _segments(path: Path) -> Json:
    """segments.json, {} if there is none."""
    again = f"`{resume_command(path.parent)}` makes the final again."
    mend = f"Delete it, final.json, summary.json and report.html, and {again}"
    return _shaped(path, dict[str, dict[str, Segments]], mend)


def _shaped(path: Path, shape: Any, mend: str) -> Json:
    """The file's object, {} if there is no such file. shape: what it must hold; mend: as of `_json`."""
    found = _json(path, mend)
    if path.is_file():
        try:
            TypeAdapter(shape).validate_python(found)
        except ValidationError as error:
            raise RunError(f"{path}: damaged ({explain(error, Part).rstrip('.')}). {mend}") from error
    return found


def without_segments(run: RunData) -> str | None:
    """What is to be said of a run that has a final and lacks its segments.json, which the report has a figure of."""
    if run.segments or not any(entry.get("speeds") for entry in run.final.values()):
        return None
    return (
        f"{run.folder / 'segments.json'}: is missing, so the report lacks the figure of the final's segments. Delete "
        f"final.json, summary.json and report.html, and `{resume_command(run.folder)}` makes the final again."
    )


def _json(path: Path, mend: str) -> Json:
    """The file's object, {} if there is no such file. mend: the end of what is said of a damaged one."""
    if not path.is_file():
        return {}
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise RunError(f"{path}: cannot be read as JSON ({error}). It was cut off or edited. {mend}") from error
    if not isinstance(found, dict):
        raise RunError(f"{path}: holds a {type(found).__name__}, expected an object. {mend}")
    return found


def _yaml(path: Path) -> Json:
    if not path.is_file():
        return {}
    try:
        found = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        reason = " ".join(str(error).split())
        raise RunError(f"{path}: cannot be read as YAML ({reason}). It was cut off or edited; restore it.") from error
    return found if isinstance(found, dict) else {}
