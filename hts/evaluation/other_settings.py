"""A run's settings with some of its evaluation and of its world laid over them, for `hts evaluate --set`."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hts.config import RunConfig
from hts.config_loading import load_config, read_config
from hts.errors import ConfigError
from hts.layers import plain
from hts.overrides import Override
from hts.whole_paths import with_whole_paths

if TYPE_CHECKING:
    from hts.plugins import Registry

SECTIONS = ("evaluation", "world")
"""What of a run's settings an evaluation after it may have otherwise: where and how policies are compared. All others
have made the policy."""


def with_others(folder: Path, world: str | None, overrides: Sequence[Override], registry: Registry) -> RunConfig:
    """The configuration of the run in `folder`, for an evaluation: in `world`, if one is named, and with `overrides`.

    A world that is another one than the run's has that one's settings, none of the run's. Paths are absolute. Raises
    ConfigError for a key of another section, and for what is wrong with a value.
    """
    file = folder / "config.yaml"
    kept = read_config(file)
    strange = next((one for one in overrides if one.path[0] not in SECTIONS), None)
    if strange is not None:
        raise ConfigError(
            f"{strange.text}: has made the run's policies and cannot be another one afterwards; an evaluation takes "
            f"{' and '.join(f'{section}.…' for section in SECTIONS)}."
        )
    named = next((one for one in overrides if one.path in {("world",), ("world", "name")}), None)
    if named is not None:
        raise ConfigError(f"{named.text}: say --world NAME.")
    if not overrides and world in (None, kept.world.name):
        return kept
    config = load_config(file=file, world=world, overrides=overrides, registry=registry)
    return with_whole_paths(config, registry)


def as_values(overrides: Sequence[Override]) -> dict[str, Any]:
    """Dotted key -> value, as JSON holds it. Raises ConfigError for one that it cannot hold."""
    found = {".".join(one.path): plain(one.value) for one in overrides}
    for key, value in found.items():
        try:
            json.dumps(value, allow_nan=False)
        except (TypeError, ValueError) as error:
            raise ConfigError(f"{key}: {type(value).__name__}, expected what JSON can hold ({error}).") from error
    return found


def as_options(values: Mapping[str, Any]) -> list[str]:
    """The words of a command line that say the same, not quoted yet."""
    return [word for key, value in values.items() for word in ("--set", f"{key}={json.dumps(value)}")]
