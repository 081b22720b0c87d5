"""Paths in a robot's and a world's settings: which they are, and absolute before a run keeps them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, get_args

from hts.config import RunConfig
from hts.config_base import Named, NameOrFile
from hts.plugin_settings import settings_model

if TYPE_CHECKING:
    from pydantic.fields import FieldInfo

    from hts.plugins import Registry


def with_whole_paths(config: RunConfig, registry: Registry) -> RunConfig:
    """The same configuration with relative paths in the settings of its robot and world absolute, as seen from here.

    What does not lie here stays as it is written: its plugin may look elsewhere.
    """

    def whole(kind: str, one: Named) -> Named:
        found = {key: Path(value) for key, value in files_of(registry, kind, one).items()}
        here = {key: str(path.resolve()) for key, path in found.items() if not path.is_absolute() and path.exists()}
        return Named(name=one.name, **{**one.settings, **here}) if here else one

    return config.model_copy(update={"robot": whole("robots", config.robot), "world": whole("worlds", config.world)})


def files_of(registry: Registry, kind: str, one: Named) -> dict[str, str]:
    """Settings of a plugin that are the path of a file, as its settings' types say. kind: `robots` or `worlds`."""
    texts = {key: str(value) for key, value in one.settings.items() if isinstance(value, (str, Path))}
    model = settings_model(registry, kind, one.name) if texts else None
    fields: Mapping[str, FieldInfo] = model.model_fields if model is not None else {}
    return {key: text for key, text in texts.items() if _names_file(fields.get(key), text)}


def _names_file(field: FieldInfo | None, value: str) -> bool:
    """Whether the setting's type says that this is a path."""
    if field is None:
        return False
    rules = [rule for rule in field.metadata if isinstance(rule, NameOrFile)]
    return rules[0].is_file(value) if rules else Path in (field.annotation, *get_args(field.annotation))
