"""YAML as people write it, read strictly: no key twice, no bottomless nesting, and one line for what cannot be read."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

from hts.errors import ConfigError

MAX_DEPTH = 30
"""Levels of lists and mappings; a configuration needs six."""


SHOWN = 40
"""Characters of a line that is quoted."""


class _StrictLoader(yaml.SafeLoader):
    """PyYAML's safe loader keeps the last of two equal keys without a word, and reads on as deep as Python calls; this
    one refuses both."""

    def __init__(self, stream: str) -> None:
        super().__init__(stream)
        self._depth = 0

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        """What is too deep is refused where it begins: a thousand brackets take seconds to read to their end."""
        if self._depth > MAX_DEPTH and not self.check_event(yaml.ScalarEvent, yaml.AliasEvent):
            raise RecursionError
        self._depth += 1
        try:
            return super().compose_node(parent, index)
        finally:
            self._depth -= 1

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        first: dict[tuple[str, str], int] = {}
        for key, _ in node.value:
            if not isinstance(key, yaml.ScalarNode) or key.tag == "tag:yaml.org,2002:merge":
                continue
            if (key.tag, key.value) in first:
                raise _twice(key, first[key.tag, key.value])
            first[key.tag, key.value] = key.start_mark.line + 1
        return super().construct_mapping(node, deep)

    def construct_yaml_int(self, node: yaml.ScalarNode) -> int:
        """Whole numbers as people count: what YAML 1.1 reads to the base 8 or 60 is refused."""
        if re.fullmatch(r"[-+]?0[0-7_]+", node.value) or ":" in node.value:
            raise _other_base(node, int(super().construct_yaml_int(node)))
        return int(super().construct_yaml_int(node))

    def construct_yaml_float(self, node: yaml.ScalarNode) -> float:
        """The same for what has a point."""
        if ":" in node.value:
            raise _other_base(node, float(super().construct_yaml_float(node)))
        return float(super().construct_yaml_float(node))


_StrictLoader.add_constructor("tag:yaml.org,2002:int", _StrictLoader.construct_yaml_int)
_StrictLoader.add_constructor("tag:yaml.org,2002:float", _StrictLoader.construct_yaml_float)


def _other_base(node: yaml.ScalarNode, read: float) -> yaml.MarkedYAMLError:
    base = "60" if ":" in node.value else "8"
    problem = (
        f"{node.value} counts to the base {base} there and would be {read:g}; write the number that is meant without a "
        f'0 in front or a colon, or "{node.value}" for text'
    )
    return yaml.MarkedYAMLError(problem=problem, problem_mark=node.start_mark)


def _twice(key: yaml.ScalarNode, earlier: int) -> yaml.MarkedYAMLError:
    problem = f"the key '{key.value}' was written before, in line {earlier}; write it once"
    return yaml.MarkedYAMLError(problem=problem, problem_mark=key.start_mark)


def load_text(text: str, where: str) -> Any:
    """The value of a YAML text. Raises ConfigError, one line that begins with `where` and the line's number.

    Refused beside what is no YAML: a key that stands twice in one mapping, numbers to the base 8 or 60, more than
    `MAX_DEPTH` levels, a value that holds itself by an alias, keys that are not text or numbers.
    """
    try:
        value = yaml.load(text, _StrictLoader)
    except yaml.YAMLError as error:
        place, problem = where, " ".join(str(error).split())
        if isinstance(error, yaml.MarkedYAMLError):
            problem = error.problem or problem
            place = f"{where}:{error.problem_mark.line + 1}" if error.problem_mark is not None else where
        raise ConfigError(f"{place}: not YAML: {problem or 'cannot be read'}.") from error
    except RecursionError:
        raise ConfigError(_too_deep(where)) from None  # the cause is a thousand lines of the reader's own calls
    except ValueError as error:  # such as the date 2026-99-99
        raise ConfigError(f"{where}: not YAML: {' '.join(str(error).split())}.") from error
    _check_depth(value, where)
    return value


def load_mapping_file(file: Path, what: str = "config file") -> dict[str, Any]:
    """The keys and values of a YAML file; empty for an empty file. Raises ConfigError as `load_text`."""
    try:
        text = file.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = (error.strerror if isinstance(error, OSError) else None) or str(error)
        raise ConfigError(f"{file}: cannot read this {what} ({reason}).") from error
    values = load_text(text, str(file))
    if values is None:
        return {}
    if not isinstance(values, dict):
        raise ConfigError(f"{file}: expected keys and values (KEY: VALUE), found {_said(values, text, what)}.")
    for key in values:
        if not isinstance(key, str):
            raise ConfigError(f"{file}: expected keys and values (KEY: VALUE), found the key {key!r}.")
    return values


def _said(value: Any, text: str, what: str) -> str:
    """What a file is that holds no mapping, and what to do about it."""
    if isinstance(value, list):
        return "a list"
    if not isinstance(value, str):
        return repr(value)
    first = next(line.strip() for line in text.splitlines() if line.strip())
    shown = repr(first if len(first) <= SHOWN else first[:SHOWN] + "…")
    if "," in first or ";" in first:
        return f"comma-separated text, {shown}. It is a table, no {what}: give the file that says what is in it"
    return f"text, {shown}. Is it a {what}?"


def _check_depth(value: Any, where: str) -> None:
    """Walk all of it, each container once a level: an alias may name one many times, or the one that holds it."""
    deepest: dict[int, int] = {}
    waiting = [(value, 1)]
    while waiting:
        one, depth = waiting.pop()
        if not isinstance(one, (Mapping, list)) or deepest.get(id(one), 0) >= depth:
            continue
        if depth > MAX_DEPTH:
            raise ConfigError(_too_deep(where))
        deepest[id(one)] = depth
        waiting += [(item, depth + 1) for item in (one.values() if isinstance(one, Mapping) else one)]


def _too_deep(where: str) -> str:
    return f"{where}: lists and mappings stand more than {MAX_DEPTH} levels inside each other; no configuration does."
