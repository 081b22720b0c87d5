"""Which settings a plugin takes, with defaults and descriptions, found out without a word from its author.

A factory hands its settings to a pydantic model that refuses unknown keys (`hts check` wants that). So it is asked for
something with a key that nobody has, and the model that refuses the key is the one. What is not checked by such a
model stays unknown, and is left as it is written.
"""

from __future__ import annotations

import dataclasses
import json
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import UnionType
from typing import TYPE_CHECKING, Annotated, Any, Literal, Union, get_args, get_origin

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
    """One setting: its dotted key, its default as YAML would have it (None with `needed`), what it means, its type in
    Python's words, and the bounds of its values ("> 0, ≤ 1"; empty without any)."""

    key: str
    default: Any
    description: str
    needed: bool = False
    type: str = ""
    bounds: str = ""


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
            yield setting_of(key, field)


def setting_of(key: str, field: FieldInfo) -> Setting:
    """One field of a model, as it is whatever its type."""
    required = field.is_required()
    return Setting(key, _default(field), field.description or "", required, type_text(field.annotation), _bounds(field))


def type_text(annotation: Any) -> str:
    """A type as one would write it: `tuple[float, ...]`, `int | None`, `"best" | "front"`, `ScheduleConfig`."""
    origin, inner = get_origin(annotation), get_args(annotation)
    if annotation is type(None):
        return "None"
    if origin is Literal:
        return " | ".join(json.dumps(value) for value in inner)
    if origin is Annotated:
        return type_text(inner[0])
    if origin in (Union, UnionType):
        return " | ".join(type_text(one) for one in inner)
    if origin is not None:
        return f"{origin.__name__}[{', '.join('...' if one is Ellipsis else type_text(one) for one in inner)}]"
    return annotation.__name__ if isinstance(annotation, type) else str(annotation).removeprefix("typing.")


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


BOUNDS = {"gt": "> {}", "ge": "≥ {}", "lt": "< {}", "le": "≤ {}", "min_length": "at least {} of them"}
"""Constraints as `annotated_types` names them -> how they are written."""


def _bounds(field: FieldInfo) -> str:
    """Of a list, of its length; limits that stand elsewhere (in validators) are not known here."""
    found = [_values_of(one) for one in field.metadata]
    return ", ".join(text.format(one[name]) for one in found for name, text in BOUNDS.items() if name in one)


def _values_of(constraint: Any) -> dict[str, Any]:
    """The fields of a constraint that have a value."""
    if not dataclasses.is_dataclass(constraint):
        return {}
    found = {one.name: getattr(constraint, one.name) for one in dataclasses.fields(constraint)}
    return {name: value for name, value in found.items() if value is not None}


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
