"""What many tests share: plugin packages made inside a test, and the command line in a process of its own."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path

import pytest

from hts.testing.packages import write_package

# One thread each: tests run side by side on few cores. Set before torch is imported anywhere.
os.environ.setdefault("OMP_NUM_THREADS", "1")

Install = Callable[..., Path]


@pytest.fixture
def install(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> Iterator[Install]:
    """install(package, {module: source}, entry_points) -> folder: a package that this test sees, gone afterwards."""
    folder = tmp_path_factory.mktemp("site-packages")
    monkeypatch.syspath_prepend(str(folder))
    before = set(sys.modules)

    def install(package: str, modules: Mapping[str, str], entry_points: Mapping[str, str]) -> Path:
        files = {f"{name}.py": source for name, source in modules.items()}
        return write_package(folder, package, files, entry_points)

    yield install
    for name in set(sys.modules) - before:
        if getattr(sys.modules[name], "__file__", None) and str(folder) in str(sys.modules[name].__file__):
            del sys.modules[name]


@pytest.fixture
def hts() -> Callable[..., subprocess.CompletedProcess[str]]:
    """hts(*arguments, path=…, cwd=…): the command line in a process of its own, output captured as text."""

    def run(
        *arguments: str | Path,
        path: Sequence[Path] = (),
        cwd: Path | None = None,
        timeout: float = 120.0,
        env: Mapping[str, str] | None = None,
    ) -> subprocess.CompletedProcess[str]:
        searched = [*map(str, path), os.environ.get("PYTHONPATH", "")]
        environment = {**os.environ, **(env or {}), "PYTHONPATH": os.pathsep.join(filter(None, searched))}
        return subprocess.run(
            [sys.executable, "-m", "hts.cli.main", *map(str, arguments)],
            capture_output=True,
            text=True,
            timeout=timeout,
            env=environment,
            cwd=cwd,
            check=False,
        )

    return run
