"""The fields of dataclasses, and signatures, as Markdown: what `hts.testing.field_tables` writes beside settings."""

from __future__ import annotations

import ast
import dataclasses
import importlib
import inspect
import re
import textwrap
from collections.abc import Iterator
from typing import Any, ForwardRef

HEAD = ("| field | type | default | meaning |", "|---|---|---|---|")
NAMES = re.compile(r"`*(\w+(?:`*(?:, | and )`*\w+)*)`*:? +(.*)")


def fields_table(made: type) -> str:
    """One row a field of a dataclass or a NamedTuple, in the order in which they are written."""
    meanings, defaults, types = _meanings(made), _defaults(made), _types(made)
    lines = list(HEAD)
    for name, kind in types.items():
        default = f"`{cell(defaults[name])}`" if name in defaults else "needed"
        lines.append(f"| `{name}` | `{cell(kind)}` | {default} | {cell(meanings.get(name, ''))} |")
    return "\n".join(lines) + "\n"


def without_meaning(made: type) -> list[str]:
    """Fields of which neither the docstring nor a comment beside them says what they are."""
    return [name for name in _types(made) if not _meanings(made).get(name)]


def has_fields(one: Any) -> bool:
    """Whether it is a dataclass or a NamedTuple."""
    return isinstance(one, type) and (dataclasses.is_dataclass(one) or "_field_defaults" in vars(one))


def signature_list(path: str) -> str:
    """One line for each public function and class of a module, `package.module`, or for each public method and property
    that a class, `package.module.Class`, has of its own: its signature, and what its docstring begins with."""
    home, _, last = path.rpartition(".")
    if last[:1].isupper():
        found = _members(getattr(importlib.import_module(home), last))
    else:
        found = _public(importlib.import_module(path))
    return "\n".join(f"- `{name}{_signature(one)}`: {_first_sentence(one)}" for name, one in found) + "\n"


def cell(text: str) -> str:
    """One line in which no bar ends the cell."""
    return " ".join(text.split()).replace("|", "\\|")


def _public(module: Any) -> Iterator[tuple[str, Any]]:
    """By `__all__`; of a module without one, what is defined there."""
    named = vars(module).get("__all__")
    for name in named or vars(module):
        one = getattr(module, name)
        if not (inspect.isclass(one) or inspect.isfunction(one)):
            continue
        if named or (one.__module__ == module.__name__ and not name.startswith("_")):
            yield name, one


def _members(made: type) -> Iterator[tuple[str, Any]]:
    """Public methods and properties of a class that it does not inherit and that say what they are."""
    for name, one in vars(made).items():
        if not name.startswith("_") and (inspect.isfunction(one) or isinstance(one, property)) and one.__doc__:
            yield name, one


class _Bare:
    """An annotation that is shown as it was written, without quotes."""

    def __init__(self, text: str) -> None:
        self.text = text

    def __repr__(self) -> str:
        return self.text


def _signature(one: Any) -> str:
    def bare(annotation: Any) -> Any:
        return _Bare(annotation) if isinstance(annotation, str) else annotation

    if isinstance(one, property):
        return ""
    found = inspect.signature(one)
    parameters = [each.replace(annotation=bare(each.annotation)) for each in found.parameters.values()]
    back = inspect.Signature.empty if inspect.isclass(one) else bare(found.return_annotation)
    return str(found.replace(parameters=parameters, return_annotation=back))


def _first_sentence(one: Any) -> str:
    """Up to the first full stop, or the first empty line."""
    paragraph = " ".join((inspect.getdoc(one) or "").partition("\n\n")[0].split())
    return re.split(r"(?<=\.) (?=[A-Z])", paragraph, maxsplit=1)[0]


def _types(made: type) -> dict[str, str]:
    """Field -> its type as it is written; inherited ones first."""
    if dataclasses.is_dataclass(made):
        return {one.name: _text(one.type) for one in dataclasses.fields(made)}
    return {name: _text(kind) for name, kind in made.__annotations__.items()}


def _text(kind: Any) -> str:
    """A type as it is written; a NamedTuple holds forward references."""
    if isinstance(kind, str):
        return kind
    if isinstance(kind, ForwardRef):
        return kind.__forward_arg__
    return kind.__name__ if isinstance(kind, type) else str(kind)


def _defaults(made: type) -> dict[str, str]:
    if not dataclasses.is_dataclass(made):
        return {name: repr(value) for name, value in vars(made)["_field_defaults"].items()}
    found = {}
    for one in dataclasses.fields(made):
        if one.default is not dataclasses.MISSING:
            found[one.name] = repr(one.default)
        elif one.default_factory is not dataclasses.MISSING:
            found[one.name] = repr(one.default_factory())
    return found


def _meanings(made: type) -> dict[str, str]:
    """Field -> the docstring's "name: meaning", or the comment beside it.

    What follows a meaning belongs to it, up to the next field's name or the end of the paragraph.
    """
    known = set(_types(made))
    found = _comments(made) | _explained(inspect.getdoc(made) or "", known)
    return {name: meaning for name, meaning in found.items() if name in known}


def _explained(docstring: str, known: set[str]) -> dict[str, str]:
    found: dict[str, str] = {}
    for paragraph in docstring.split("\n\n"):
        pieces = re.split(r"(?<=[;.])\s+", " ".join(paragraph.split()))
        names: list[str] = []
        for piece in pieces:
            match = NAMES.fullmatch(piece)
            given = re.split(r"`*(?:, | and )`*", match[1]) if match else []
            if match and set(given) <= known:
                names = given
                found |= dict.fromkeys(names, match[2])
            else:
                found |= {name: f"{found[name]} {piece}" for name in names}
    return {name: meaning.rstrip(".;") for name, meaning in found.items()}


def _comments(made: type) -> dict[str, str]:
    source = textwrap.dedent(inspect.getsource(made))
    lines = source.splitlines()
    found = {}
    for node in ast.parse(source).body[0].body:  # type: ignore[attr-defined]
        if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            after = lines[(node.end_lineno or 1) - 1][node.end_col_offset or 0 :].strip()
            if after.startswith("#") and "type:" not in after and "noqa" not in after:
                found[node.target.id] = after.lstrip("# ")
    return found
