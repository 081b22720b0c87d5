"""Paths in a robot's and a world's settings, made absolute before a run keeps them: it is resumed from any folder."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args

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
        found = {key: value for key, value in one.settings.items() if _lies_here(value)}
        model = settings_model(registry, kind, one.name) if found else None
        fields: Mapping[str, FieldInfo] = model.model_fields if model is not None else {}
        paths = {key: str(Path(value).resolve()) for key, value in found.items() if _names_file(fields.get(key), value)}
        return Named(name=one.name, **{**one.settings, **paths}) if paths else one

    return config.model_copy(update={"robot": whole("robots", config.robot), "world": whole("worlds", config.world)})


def _lies_here(value: Any) -> bool:
    """Whether it could be a relative path of something that is there."""
    return isinstance(value, (str, Path)) and not os.path.isabs(value) and os.path.exists(value)


def _names_file(field: FieldInfo | None, value: str | Path) -> bool:
    """Whether the setting's type says that this is a path."""
    if field is None:
        return False
    rules = [rule for rule in field.metadata if isinstance(rule, NameOrFile)]
    return rules[0].is_file(str(value)) if rules else Path in (field.annotation, *get_args(field.annotation))
