"""The fields of pydantic models as Markdown tables, kept in a page that can be read as it lies in the repository.

    python -m hts.testing.field_tables PAGE.md …

writes anew what stands between `<!-- fields: package.module.Model -->` and `<!-- end of fields -->`: names, types,
defaults, bounds and descriptions, as `hts plugins NAME` and the schema of config files have them.
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

PART = re.compile(r"(<!-- fields: (\S+) -->\n).*?(<!-- end of fields -->)", re.DOTALL)
HEAD = ("| field | type | default | bounds | meaning |", "|---|---|---|---|---|")


def field_table(model: type[BaseModel]) -> str:
    """One row a field, in the order in which they are written."""
    lines = list(HEAD)
    for one in (setting_of(name, field) for name, field in model.model_fields.items()):
        default = "needed" if one.needed else _code(_default(one.default))
        cells = (f"`{one.key}`", _code(one.type), default, one.bounds, _cell(one.description))
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def renewed(text: str) -> str:
    """The page with every table as its model has it now. Raises ImportError or AttributeError for no such model."""

    def table(part: re.Match[str]) -> str:
        return f"{part[1]}\n{field_table(model_of(part[2]))}\n{part[3]}"

    return PART.sub(table, text)


def model_of(path: str) -> type[BaseModel]:
    """`package.module.Model`, imported."""
    module, _, name = path.rpartition(".")
    return getattr(importlib.import_module(module), name)


def _default(value: Any) -> str:
    """As YAML has it; a section's own defaults stand in its own table."""
    if isinstance(value, dict) and value:
        return "{…}"
    return json.dumps(value, ensure_ascii=False, default=str)


def _code(text: str) -> str:
    return f"`{_cell(text)}`"


def _cell(text: str) -> str:
    """One line in which no bar ends the cell."""
    return " ".join(text.split()).replace("|", "\\|")


def main(pages: list[str]) -> None:
    """Renew each page in place."""
    for page in map(Path, pages):
        atomic_write(page, renewed(page.read_text(encoding="utf-8")))


if __name__ == "__main__":
    main(sys.argv[1:])
