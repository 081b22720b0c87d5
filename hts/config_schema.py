"""The JSON schema of a config file, for editors: the core's sections, and the settings of every installed plugin.

Nothing is required that a preset or an option of the command line may give; the items of a list are replaced whole, so
those keep what they need.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from pydantic import BaseModel

from hts.config import RunConfig
from hts.contracts import MODEL
from hts.plugin_settings import settings_model

if TYPE_CHECKING:
    from hts.plugins import Registry

Schema = dict[str, Any]


def config_schema(registry: Registry) -> Schema:
    """JSON schema (2020-12) of what `--config FILE` takes."""
    schema = RunConfig.model_json_schema()
    definitions: Schema = schema.setdefault("$defs", {})
    definitions.pop("Named", None)
    properties: Schema = schema["properties"]
    properties["objectives"] = _objectives(registry, definitions)
    properties["robot"] = _named(registry, "robots", definitions, "The machine.")
    properties["world"] = _named(registry, "worlds", definitions, 'Where policies run "for real".')
    definitions["SelectionConfig"]["properties"]["selector"] = _named(
        registry, "selectors", definitions, "Who is tested and who goes on."
    )
    schema["title"] = "hts config file"
    kept = _items_of_lists(schema)
    for name, section in [("", schema), *definitions.items()]:
        if name not in kept:
            section.pop("required", None)
    return schema


def _named(registry: Registry, kind: str, definitions: Schema, description: str) -> Schema:
    """A name, or a mapping with a name and the settings of the plugin of that name."""
    names = sorted(registry.offered(kind))
    chosen: list[Schema] = []
    for name in names:
        reference = _settings(registry, kind, name, definitions, {"name": {"const": name}})
        if reference is not None:
            chosen.append({"if": {"properties": {"name": {"const": name}}, "required": ["name"]}, "then": reference})
    mapping: Schema = {"type": "object", "properties": {"name": {"enum": names}}}
    if chosen:
        mapping["allOf"] = chosen
    return {"description": description, "anyOf": [{"enum": names}, mapping]}


def _objectives(registry: Registry, definitions: Schema) -> Schema:
    """A name, a list of names, or a mapping from names to settings."""
    names = sorted(registry.objectives)
    settings: Schema = {}
    model = _named(
        registry, "measurement_models", definitions, "What predicts the measurement; left out: the objective's own."
    )
    for name in names:
        reference = _settings(registry, "objectives", name, definitions, {MODEL: model})
        settings[name] = {"anyOf": [reference or {"type": "object"}, {"type": "null"}]}
    mapping = {"type": "object", "properties": settings, "additionalProperties": False, "minProperties": 1}
    item = {"anyOf": [{"enum": names}, mapping]}
    return {
        "description": "What to improve, and the settings of each.",
        "anyOf": [{"enum": names}, {"type": "array", "items": item, "minItems": 1}, mapping],
    }


def _settings(registry: Registry, kind: str, name: str, definitions: Schema, extra: Schema) -> Schema | None:
    """Reference to a definition of the settings of one plugin; None if they are not known.
    extra: further properties."""
    model = settings_model(registry, kind, name)
    if model is None:
        return None
    key = f"{kind}.{name}"
    definitions.update(_definitions(model, key))
    section = definitions[key]
    section["properties"] = {**extra, **section.get("properties", {})}
    return {"$ref": f"#/$defs/{key}"}


def _definitions(model: type[BaseModel], key: str) -> Schema:
    """The model's schema under `key`, and those of the models inside it under `key`.NAME."""
    schema = copy.deepcopy(model.model_json_schema(ref_template=f"#/$defs/{key}.{{model}}"))
    inner = schema.pop("$defs", {})
    return {key: schema, **{f"{key}.{name}": section for name, section in inner.items()}}


def _items_of_lists(value: Any) -> set[str]:
    """Names of the definitions that are the items of some list."""
    found: set[str] = set()
    if isinstance(value, Mapping):
        if isinstance(value.get("items"), Mapping) and "$ref" in value["items"]:
            found.add(value["items"]["$ref"].removeprefix("#/$defs/"))
        for part in value.values():
            found |= _items_of_lists(part)
    elif isinstance(value, list):
        for part in value:
            found |= _items_of_lists(part)
    return found
