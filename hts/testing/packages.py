"""A plugin package as pip would leave it, made in a folder: for tests of plugins, without pip."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path


def write_package(folder: Path, package: str, files: Mapping[str, str], entry_points: Mapping[str, str]) -> Path:
    """Write `files` (path inside the folder -> text) and a dist-info with entry points of the group `hts`.

    Returns the folder, to be put on the search path of Python.
    """
    for name, text in files.items():
        file = folder / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text, encoding="utf-8")
    info = folder / f"{package.replace('-', '_')}-1.0.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {package}\nVersion: 1.0\n", encoding="utf-8")
    lines = ["[hts]", *(f"{name} = {module}" for name, module in entry_points.items()), ""]
    (info / "entry_points.txt").write_text("\n".join(lines), encoding="utf-8")
    return folder
