"""No two files of hts import each other in a circle, imports inside functions included.

Imports for type checkers alone do not count: they name a type, and nothing runs through them.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator, Mapping
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parents[2]


def modules_of(package: Path) -> dict[str, Path]:
    """Dotted name -> file, of every module in a package."""
    found = {}
    for path in package.rglob("*.py"):
        parts = path.relative_to(package.parent).with_suffix("").parts
        found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


def imported(tree: ast.AST) -> Iterator[tuple[str, str | None]]:
    """(module, name taken from it or None) of every import that can run, wherever in the file it stands."""
    if isinstance(tree, ast.If) and "TYPE_CHECKING" in ast.unparse(tree.test):
        for node in tree.orelse:
            yield from imported(node)
        return
    if isinstance(tree, ast.Import):
        yield from ((alias.name, None) for alias in tree.names)
    if isinstance(tree, ast.ImportFrom) and tree.module and not tree.level:
        yield from ((tree.module, alias.name) for alias in tree.names)
    for node in ast.iter_child_nodes(tree):
        yield from imported(node)


def import_graph(package: Path) -> dict[str, set[str]]:
    """Module -> modules of the package that it imports."""
    modules = modules_of(package)
    graph: dict[str, set[str]] = {}
    for name, path in modules.items():
        graph[name] = set()
        for module, taken in imported(ast.parse(path.read_text(encoding="utf-8"))):
            inner = f"{module}.{taken}"
            target = inner if taken is not None and inner in modules else module
            if target in modules and target != name:
                graph[name].add(target)
    return graph


def circles(graph: Mapping[str, set[str]]) -> list[list[str]]:
    """Modules that can reach one another, each group sorted; none if the graph has no circle."""
    reach: dict[str, set[str]] = {}
    for start in graph:
        seen: set[str] = set()
        waiting = list(graph[start])
        while waiting:
            name = waiting.pop()
            if name not in seen:
                seen.add(name)
                waiting += graph[name]
        reach[start] = seen
    groups = {tuple(sorted(n for n in reach[start] if start in reach[n])) for start in graph if start in reach[start]}
    return [list(group) for group in sorted(groups)]


def test_no_files_of_the_core_import_each_other_in_a_circle():
    assert circles(import_graph(REPOSITORY / "hts")) == []


@pytest.mark.parametrize(
    ("first", "second"),
    [
        ("from pkg import second", "import pkg.first"),
        ("from pkg.second import x", "def late():\n    from pkg.first import y\n    return y"),
        ("from pkg.second import x", "class A:\n    def late(self):\n        import pkg.first"),
        ("try:\n    import pkg.second\nexcept ImportError: ...", "if True:\n    from pkg import first"),
        ("from pkg.second import x", "from pkg.third import x"),
    ],
)
def test_a_circle_is_seen(tmp_path, first, second):
    package = tmp_path / "pkg"
    package.mkdir()
    files = {
        "__init__": "",
        "first": first,
        "second": second,
        "third": "from pkg.first import y",
        "fourth": "import pkg.first",
    }
    for name, text in files.items():
        (package / f"{name}.py").write_text(text)
    (found,) = circles(import_graph(package))
    assert {"pkg.first", "pkg.second"} <= set(found)
    assert "pkg.fourth" not in found


@pytest.mark.parametrize(
    "second",
    [
        "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from pkg.first import y",
        "from pkg import third",
        "import json",
    ],
)
def test_what_is_no_circle_passes(tmp_path, second):
    package = tmp_path / "pkg"
    package.mkdir()
    for name, text in {"__init__": "", "first": "from pkg.second import x", "second": second, "third": ""}.items():
        (package / f"{name}.py").write_text(text)
    assert circles(import_graph(package)) == []
