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
from hts.explain import Location, dotted, shortened
from hts.yaml_text import load_mapping_file

NAME = re.compile(r"[\w-][\w.-]*")


def _text(value: object) -> object:
    """A number is meant as text: `seeds: 0`, `commit: 1234567`."""
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
    commit: Annotated[str | None, BeforeValidator(_text)] = Field(
        None, description="of the sources; none: what the command line says"
    )
    cores: int = Field(2, gt=0, strict=True, description="per run")
    gpu: bool = Field(
        False, strict=True, description="whether a run takes a GPU, shared with others; false: all are hidden"
    )


@dataclass(frozen=True)
class Planned:
    """A run, its batch, and what it needs. where: of the file, batch and entry."""

    job: Job
    where: str
    batch: str
    need: Need


def read_several(file: Path) -> dict[str, list[Entry]]:
    """Batch -> its entries: a YAML mapping of lists. Raises ConfigError, naming the file, the batch and the key."""
    found: dict[str, list[Entry]] = {}
    for name, rows in load_mapping_file(file, "file of batches").items():
        if not NAME.fullmatch(name):
            raise ConfigError(
                f"{file}: '{name}' is no name of a batch. Its lines go to a file of this name: use letters, digits, "
                "'.', '_' and '-'."
            )
        if not isinstance(rows, list) or not rows:
            raise ConfigError(f"{file}: {name}: expected a list of entries (- methods: …), found {shortened(rows)}.")
        found[name] = [_entry(row, f"{file}: {name}.{index}") for index, row in enumerate(rows)]
    if not found:
        raise ConfigError(f"{file}: asks for no batch. Expected the name of one, and below it a list of entries.")
    return found


def _entry(row: object, where: str) -> Entry:
    if not isinstance(row, dict):
        raise ConfigError(f"{where}: expected keys and values (methods: …), found {shortened(row)}.")

    def origin(location: Location) -> str:
        return f"{where}.{dotted(location)}" if location else where

    return section_of(Entry, row, origin)


def planned(file: Path, jobs_of: Callable[[Entry], Sequence[Job]], cores: int, gpus: Sequence[str]) -> list[Planned]:
    """Every run that the file asks for, in its order. cores, gpus: how many there are, and which.

    Raises ConfigError for what no machine like this one could do, and for a run that is asked for twice.
    """
    found: dict[str, Planned] = {}
    for batch, entries in read_several(file).items():
        for index, entry in enumerate(entries):
            where = f"{batch}.{index}"
            if entry.cores > cores:
                raise ConfigError(
                    f"{file}: {where} asks for {entry.cores} cores a run; this machine has {cores}. Lower `cores` "
                    "there, or go to a larger machine."
                )
            if entry.gpu and not gpus:
                raise ConfigError(
                    f"{file}: {where} asks for a GPU, and --gpus gives none. Name some, go to a machine that has "
                    "them, or leave out `gpu: true` there."
                )
            try:
                jobs = jobs_of(entry)
            except ConfigError as error:
                raise ConfigError(f"{file}: {where}: {error}") from error
            if not jobs:
                raise ConfigError(f"{file}: {where} asks for no run: methods is {entry.methods!r}. Name one.")
            for job in jobs:
                earlier = found.setdefault(job.key, Planned(job, where, batch, Need(entry.cores, entry.gpu)))
                if earlier.job is not job:
                    raise ConfigError(
                        f"{file}: {job.method} on {job.reality}, seed {job.seed}, is asked for twice, by "
                        f"{earlier.where} and by {where}. Leave one out."
                    )
    return list(found.values())
