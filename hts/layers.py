"""Layers of a configuration, one over the other: a preset, a file, options, --set; the later one wins.

Mappings are laid key by key, anything else is replaced whole. Where a mapping names a plugin (it has a `name`), the
last layer that gives a name decides, and what the others wrote for a plugin of another name is dropped. Settings of a
layer that gives no name belong to whichever plugin it turns out to be, so it does not matter what was written first.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from hts.errors import ConfigError

NAMED = (("robot",), ("world",), ("selection", "selector"))
"""Where one plugin is chosen: a name, or a mapping with the name and its settings."""


def laid(*layers: Mapping[str, Any]) -> dict[str, Any]:
    """One mapping from all layers; none of them is changed."""
    keys = dict.fromkeys(key for layer in layers for key in layer)
    return {key: _laid([layer[key] for layer in layers if key in layer]) for key in keys}


def _laid(values: list[Any]) -> Any:
    first = len(values)
    while first and isinstance(values[first - 1], Mapping):
        first -= 1
    mappings = values[first:]
    if not mappings:
        return values[-1]
    names = [one["name"] for one in mappings if "name" in one]
    return laid(*(one for one in mappings if not names or one.get("name", names[-1]) == names[-1]))


def in_full(layer: Mapping[str, Any], where: str) -> dict[str, Any]:
    """A layer with its short forms written out: `robot: NAME`, `objectives: [NAME, …]` and their like.

    where: the file or option, for messages. Raises ConfigError for what is neither form.
    """
    result = dict(layer)
    for path in NAMED:
        _write_out(result, path, where)
    if "objectives" in result:
        objectives = _objectives(result["objectives"], where)
        result["objectives"] = {name: with_named_model(settings) for name, settings in objectives.items()}
    return result


def _write_out(values: dict[str, Any], path: tuple[str, ...], where: str, shown: str = "") -> None:
    """Replace a bare name by {"name": …} at `path`, copying the mappings on the way."""
    key, rest = path[0], path[1:]
    shown = f"{shown}.{key}" if shown else key
    below = values.get(key)
    if rest:
        if isinstance(below, Mapping):
            values[key] = copied = dict(below)
            _write_out(copied, rest, where, shown)
    elif isinstance(below, str):
        values[key] = {"name": below}
    elif below is None:
        values.pop(key, None)
    elif not isinstance(below, Mapping):
        raise ConfigError(f"{where}: {shown}: expected a name, or a name and its settings, found {below!r}.")


def _objectives(given: Any, where: str) -> dict[str, Any]:
    """{name: settings} from a name, a list of names, or a mapping in which a name may have no settings."""
    if given is None:
        return {}
    if isinstance(given, str):
        return {given: {}}
    if isinstance(given, Mapping):
        return {_name(name, where): {} if settings is None else settings for name, settings in given.items()}
    if not isinstance(given, (list, tuple)):
        raise ConfigError(f"{where}: objectives: expected names, or names and their settings, found {given!r}.")
    result: dict[str, Any] = {}
    for item in given:
        one = _objectives(item, where) if isinstance(item, (str, Mapping)) else {_name(item, where): {}}
        for name, settings in one.items():
            if name in result:
                raise ConfigError(f"{where}: objectives: '{name}' stands there twice.")
            result[name] = settings
    return result


def with_named_model(settings: Any) -> Any:
    """`model: NAME` of an objective written out, so that its settings in other layers lie on it."""
    if isinstance(settings, Mapping) and isinstance(settings.get("model"), str):
        return {**settings, "model": {"name": settings["model"]}}
    return settings


def _name(name: Any, where: str) -> str:
    if not isinstance(name, str):
        raise ConfigError(f"{where}: objectives: expected a name, found {name!r}.")
    return name


def plain(value: Any) -> Any:
    """Tuples to lists and paths to text, all the way down: what YAML and JSON can write."""
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    return str(value) if isinstance(value, Path) else value
