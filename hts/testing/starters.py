"""Packages to start from, as `hts new KIND NAME` writes them: they install, pass `hts check`, and say what to change."""

from __future__ import annotations

import keyword
import re
from pathlib import Path
from string import Template

from hts.errors import ConfigError, RunError, unknown_name
from hts.testing.starter_texts import PROJECT, STARTERS, TEST


def write_starter(kind: str, name: str, parent: Path) -> Path:
    """Write a package for one objective, robot or selector into `parent`/hts-NAME; the folder.

    Raises ConfigError for a kind or name that cannot be, RunError if the folder exists.
    """
    if kind not in STARTERS:
        raise ConfigError(unknown_name("kind of package", kind, STARTERS))
    if not re.fullmatch(r"[a-z][a-z0-9_]*", name) or keyword.iskeyword(name):
        raise ConfigError(
            f"'{name}' cannot name a {kind}: lower-case letters, digits and underscores, a letter first, no Python keyword."
        )
    module = f"hts_{name}"
    package = module.replace("_", "-")
    folder = parent / package
    if folder.exists():
        raise RunError(f"{folder}: exists already. Choose another name, or another place with --to DIR.")
    words = {
        "name": name,
        "Name": name.title().replace("_", ""),
        "module": module,
        "package": package,
        "kind": kind,
    }
    plugin, parts = STARTERS[kind]
    files = {
        "pyproject.toml": PROJECT,
        f"{module}/__init__.py": '"""The $kind `$name`, for hts."""\n',
        f"{module}/plugin.py": plugin,
        f"{module}/{kind}.py": parts,
        f"tests/test_{name}.py": TEST,
    }
    for file, text in files.items():
        path = folder / file
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(Template(text).substitute(words), encoding="utf-8")
    return folder
