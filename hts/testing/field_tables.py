"""The fields of pydantic models and dataclasses as Markdown tables, and signatures, kept in a page that can be read as
it lies in the repository.

    python -m hts.testing.field_tables PAGE.md …

writes anew what stands between `<!-- fields: package.module.Model -->` and `<!-- end of fields -->`: names, types,
defaults, bounds and descriptions, as `hts plugins NAME` and the schema of config files have them; for a dataclass, what
its docstring says of each. And between `<!-- signatures: package.module -->` and `<!-- end of signatures -->` what the
module offers.
"""

from __future__ import annotations

import importlib
import json
import re
import sys
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from hts.atomic import atomic_write
from hts.plugin_settings import setting_of
from hts.testing.contract_tables import cell, fields_table, has_fields, signature_list

PART = re.compile(r"(<!-- fields: (\S+) -->\n).*?(<!-- end of fields -->)", re.DOTALL)
SIGNATURES = re.compile(r"(<!-- signatures: (\S+) -->\n).*?(<!-- end of signatures -->)", re.DOTALL)
HEAD = ("| field | type | default | bounds | meaning |", "|---|---|---|---|---|")


def field_table(model: type[BaseModel]) -> str:
    """One row a field, in the order in which they are written."""
    lines = list(HEAD)
    for one in (setting_of(name, field) for name, field in model.model_fields.items()):
        default = "needed" if one.needed else _code(_default(one.default))
        cells = (f"`{one.key}`", _code(one.type), default, one.bounds, cell(one.description))
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def renewed(text: str) -> str:
    """The page with every table as its model has it now. Raises ImportError or AttributeError for no such model."""

    def table(part: re.Match[str]) -> str:
        found = model_of(part[2])
        rows = fields_table(found) if has_fields(found) else field_table(found)
        return f"{part[1]}\n{rows}\n{part[3]}"

    def signatures(part: re.Match[str]) -> str:
        return f"{part[1]}\n{signature_list(part[2])}\n{part[3]}"

    return SIGNATURES.sub(signatures, PART.sub(table, text))


def model_of(path: str) -> type[Any]:
    """`package.module.Model`, imported."""
    module, _, name = path.rpartition(".")
    return getattr(importlib.import_module(module), name)


def _default(value: Any) -> str:
    """As YAML has it; a section's own defaults stand in its own table."""
    if isinstance(value, dict) and value:
        return "{…}"
    return json.dumps(value, ensure_ascii=False, default=str)


def _code(text: str) -> str:
    return f"`{cell(text)}`"


def main(pages: list[str]) -> None:
    """Renew each page in place."""
    for page in map(Path, pages):
        atomic_write(page, renewed(page.read_text(encoding="utf-8")))


if __name__ == "__main__":
    main(sys.argv[1:])
