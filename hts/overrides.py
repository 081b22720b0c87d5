"""`--set KEY=VALUE`: the one place where such a text becomes a key and a value, for every command that takes it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from hts.errors import ConfigError
from hts.yaml_text import load_text


@dataclass(frozen=True)
class Override:
    """One value laid over a configuration. path: the steps of its dotted key; text: as it was given, for messages;
    option: of a command, where it is another one than --set."""

    path: tuple[str, ...]
    value: Any
    text: str
    option: str | None = None

    @classmethod
    def parse(cls, text: str) -> Override:
        """From KEY=VALUE, the key dotted, the value as YAML. Raises ConfigError."""
        key, equals, value = text.partition("=")
        path = tuple(step.strip() for step in key.split("."))
        if not equals or not all(path):
            raise ConfigError(f"--set {text}: expected KEY=VALUE, e.g. --set finetune.num_envs=128")
        return cls(path, load_text(value, f"--set {text}"), f"--set {text}")

    @classmethod
    def of(cls, key: str, value: Any) -> Override:
        """From a dotted key and a value as Python has it. Raises ConfigError."""
        path = tuple(key.split("."))
        if not all(path):
            raise ConfigError(f"settings: '{key}' is no dotted key such as finetune.num_envs.")
        return cls(path, value, f"{key}={value!r}")

    @classmethod
    def by(cls, option: str, key: str, value: Any) -> Override:
        """From an option that stands for a dotted key: --steps 100 for finetune.steps."""
        return cls(tuple(key.split(".")), value, f"{option} {value}", f"{option} ({key})")


def parsed(texts: Sequence[str | Override]) -> list[Override]:
    """Each text as an Override; those that are one already stay."""
    return [text if isinstance(text, Override) else Override.parse(text) for text in texts]


def nested(
    overrides: Sequence[Override], in_full: Callable[[Mapping[str, Any], str], Mapping[str, Any]] | None = None
) -> dict[str, Any]:
    """All of them as one mapping of mappings. Of one key the last value counts; otherwise their order does not matter.

    in_full: writes out the short forms of a layer, given what it is called in messages. Raises ConfigError where one
    gives a key inside what another one made a value.
    """
    result: dict[str, Any] = {}
    for override in sorted(overrides, key=lambda one: len(one.path)):  # stable: whole sections first, then keys in them
        layer: dict[str, Any] = {override.path[-1]: override.value}
        for step in reversed(override.path[:-1]):
            layer = {step: layer}
        written = in_full(layer, override.text) if in_full is not None else layer
        check_has_keys(result, override)
        result = _joined(result, written)
    return result


def check_has_keys(values: Mapping[str, Any], override: Override) -> None:
    """Raises ConfigError if a step on the way to the key is a value in `values`, which has no keys inside."""
    below: Any = values
    for depth, step in enumerate(override.path[:-1], start=1):
        below = below.get(step)
        if below is None:
            return
        if not isinstance(below, Mapping):
            key = ".".join(override.path[:depth])
            raise ConfigError(f"{override.text}: '{key}' is a value, it has no keys inside.")


def _joined(below: Mapping[str, Any], over: Mapping[str, Any]) -> dict[str, Any]:
    result = dict(below)
    for key, value in over.items():
        before = result.get(key)
        if isinstance(value, Mapping) and isinstance(before, Mapping):
            result[key] = _joined(before, value)
        else:
            result[key] = value
    return result
