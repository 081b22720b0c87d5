"""Several batches on one machine, from a file: each run with the cores that it asks for, GPUs shared."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from pydantic import BeforeValidator, Field

from batch.methods import Job
from batch.places import Need
from hts.config_base import Config
from hts.config_loading import section_of
from hts.errors import ConfigError
from hts.explain import Location, dotted
from hts.yaml_text import load_mapping_file

NAME = re.compile(r"[\w.-]+")


def _text(value: object) -> object:
    """A number is meant as text: `seeds: 0`."""
    return str(value) if isinstance(value, int) and not isinstance(value, bool) else value


class Entry(Config):
    """Runs of one batch: what the options of `realities.py run` say, and what one of them needs."""

    methods: str = Field(description="names with commas")
    methods_file: Path | None = Field(None, description="YAML with more methods")
    realities: str = Field(description="dev, default, names, files or folders of files, with commas")
    seeds: Annotated[str, BeforeValidator(_text)] = Field("0", description="for instance 0-4")
    preset: str = Field("quick", description="of `hts run`")
    objective: tuple[str, ...] | None = Field(None, description="none: power")
    robot: str = Field("go1", description="of `hts run`")
    engine: str | None = Field(None, description="of `hts run`; none: the preset's")
    set: tuple[str, ...] = Field((), description="KEY=VALUE of every method")
    commit: str | None = Field(None, description="of the sources; none: what the command line says")
    cores: int = Field(2, gt=0, description="per run")
    gpu: bool = Field(False, description="whether a run takes a GPU, shared with others; false: all are hidden")


class Several(Config):
    """What a file asks for, in its order."""

    batches: dict[str, tuple[Entry, ...]] = Field(description="name of the batch in its lines -> its runs")


@dataclass(frozen=True)
class Planned:
    """A run, its batch, and what it needs."""

    job: Job
    batch: str
    need: Need


def read_several(file: Path) -> dict[str, tuple[Entry, ...]]:
    """Batch -> its entries: a YAML mapping of lists. Raises ConfigError, naming the file and the key."""

    def origin(location: Location) -> str:
        return f"{file}: {dotted(location[1:])}"

    values = load_mapping_file(file, "file of batches")
    for name in values:
        if not NAME.fullmatch(name):
            raise ConfigError(
                f"{file}: '{name}' is no name of a batch. Its lines go to a file of this name: use letters, digits, "
                "'.', '_' and '-'."
            )
    return section_of(Several, {"batches": values}, origin).batches


def planned(
    file: Path, jobs_of: Callable[[Entry], Sequence[Job]], cores: int, gpus: Sequence[str] | None
) -> list[Planned]:
    """Every run that the file asks for, in its order. cores, gpus: how many there are, and which.

    Raises ConfigError for what no machine like this one could do, and for a run that is asked for twice.
    """
    found: dict[str, Planned] = {}
    for batch, entries in read_several(file).items():
        for entry in entries:
            if entry.cores > cores:
                raise ConfigError(
                    f"{file}: batch '{batch}' asks for {entry.cores} cores a run; this machine has {cores}. Lower "
                    "`cores` there, or go to a larger machine."
                )
            if entry.gpu and not gpus:
                raise ConfigError(
                    f"{file}: batch '{batch}' asks for a GPU, and there is none for it. Name them (--gpus all), or "
                    "leave out `gpu: true` there."
                )
            for job in jobs_of(entry):
                earlier = found.setdefault(job.key, Planned(job, batch, Need(entry.cores, entry.gpu)))
                if earlier.job is not job:
                    raise ConfigError(
                        f"{file}: {job.method} on {job.reality}, seed {job.seed}, is asked for twice, in batch "
                        f"'{earlier.batch}' and in '{batch}'. Leave one out."
                    )
    return list(found.values())
