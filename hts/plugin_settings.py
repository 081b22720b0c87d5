"""Which settings a plugin takes, with defaults and descriptions, found out without a word from its author.

A factory hands its settings to a pydantic model that refuses unknown keys (`hts check` wants that). So it is asked for
something with a key that nobody has, and the model that refuses the key is the one. What is not checked by such a
model stays unknown, and is left as it is written.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pydantic import BaseModel, ValidationError
from pydantic_core import PydanticUndefined

from hts.channels import Channel
from hts.contracts import ModelContext, Signals, WorldContext
from hts.errors import HtsError
from hts.explain import validated_model

if TYPE_CHECKING:
    from pydantic.fields import FieldInfo

    from hts.plugins import Registry

NOBODY_HAS = "no_such_setting_of_anything"
WITH_SETTINGS = ("objectives", "measurement_models", "robots", "worlds", "instruments", "selectors", "log_readers")
"""Kinds whose factories are given settings."""


@dataclass(frozen=True)
class Setting:
    """One setting: its dotted key, its default as YAML would have it (None with `needed`), and what it means."""

    key: str
    default: Any
    description: str
    needed: bool = False


def settings_model(registry: Registry, kind: str, name: str) -> type[BaseModel] | None:
    """The pydantic model of a plugin's settings; None if it has none, or checks them in another way."""
    factory = registry.entry(kind, name).factory
    try:
        factory({NOBODY_HAS: 1}, *_rest(registry, kind))
    except ValidationError as error:
        refused = {tuple(fault["loc"]) for fault in error.errors(include_url=False, include_input=False)}
        return validated_model(error) if (NOBODY_HAS,) in refused else None
    except Exception:  # noqa: BLE001 - it says in its own way that the key is wrong, so nothing is learned of the others
        return None
    return None


def settings_of(model: type[BaseModel], prefix: str = "") -> Iterator[Setting]:
    """Every setting of a model, those of models inside it with dotted keys, in the order in which they are written."""
    for name, field in model.model_fields.items():
        key = f"{prefix}{name}"
        inner = field.annotation
        if isinstance(inner, type) and issubclass(inner, BaseModel):
            yield from settings_of(inner, f"{key}.")
        else:
            yield Setting(key, _default(field), field.description or "", field.is_required())


def in_full(registry: Registry, kind: str, name: str, settings: Mapping[str, Any]) -> dict[str, Any]:
    """The settings with those that were not given at their defaults, as YAML can write them.

    As they are where no model is known, or where the plugin does not take what its own model gives.
    """
    model = settings_model(registry, kind, name)
    if model is None:
        return dict(settings)
    try:
        full = model.model_validate(dict(settings)).model_dump(mode="json")
        model.model_validate(full)
    except (ValidationError, ValueError):
        return dict(settings)
    return full


def _default(field: FieldInfo) -> Any:
    value = field.get_default(call_default_factory=True, validated_data={})
    if value is PydanticUndefined:
        return None
    if isinstance(value, BaseModel):
        return value.model_dump(mode="json")
    return list(value) if isinstance(value, tuple) else value


def _rest(registry: Registry, kind: str) -> tuple[Any, ...]:
    """What a factory of that kind gets beside its settings; it looks at the settings first."""
    if kind == "worlds":
        nowhere = Path(tempfile.gettempdir()) / "hts-nowhere"  # a name only: worlds write with their first request
        return (WorldContext(robot="", robot_settings={}, objectives={}, seed=0, folder=nowhere),)
    if kind == "measurement_models":
        signals = Signals((Channel("input", "1"),), Channel("target", "1"), rate_hz=50.0)
        return (ModelContext(signals, registry=registry),)
    if kind != "instruments":
        return ()
    for name in registry.robots:
        try:
            return (registry.make_robot(name),)
        except HtsError:  # one that needs settings
            continue
    return (None,)
