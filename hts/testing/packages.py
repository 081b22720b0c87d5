"""Plugin packages as pip would leave them, made in a folder: for tests of plugins, without pip."""

from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

KIT = "hard-to-sim-testing"
"""Distribution under which the kit's own plugins appear, while they are installed."""


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


@contextmanager
def on_path(folder: Path) -> Iterator[Path]:
    """The folder is searched for modules and plugins, by this process and by those that it starts; then no longer."""
    before = os.environ.get("PYTHONPATH")
    sys.path.insert(0, str(folder))
    os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, [str(folder), before]))
    try:
        yield folder
    finally:
        sys.path.remove(str(folder))
        if before is None:
            del os.environ["PYTHONPATH"]
        else:
            os.environ["PYTHONPATH"] = before


@contextmanager
def kit_installed() -> Iterator[None]:
    """Robot `tiny`, objective `fake` with its instrument, measurement model `fading`, selector `plain` and world
    `known` are plugins like others."""
    with tempfile.TemporaryDirectory(prefix="hts-testing-") as folder:
        write_package(Path(folder), KIT, {}, {"kit": "hts.testing.kit_plugin"})
        with on_path(Path(folder)):
            yield
