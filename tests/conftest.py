"""What many tests share: plugin packages made inside a test, and the command line in a process of its own."""

from __future__ import annotations

import fcntl
import gc
import importlib
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, settings

from hts.cli.main import main
from hts.testing.packages import on_path, write_package

sys.path.insert(0, str(Path(__file__).parent))
from quick_figures import drawn_quickly, quick_figures  # noqa: F401 - a fixture of all tests

# The same examples everywhere: what a search finds is for the one who searches, not for whoever runs the tests next.
# Nor does a busy computer fail any: what takes long is the business of --timeout.
HASTY = [HealthCheck.too_slow]
settings.register_profile("same", derandomize=True, database=None, deadline=None, suppress_health_check=HASTY)
settings.register_profile("search", settings.get_profile("default"))
settings.load_profile(os.environ.get("HTS_HYPOTHESIS", "same"))

# One thread each: tests run side by side on few cores. Set before torch is imported anywhere.
os.environ.setdefault("OMP_NUM_THREADS", "1")

Install = Callable[..., Path]


@contextmanager
def forgotten(folders: Sequence[Path]) -> Iterator[None]:
    """What is imported from below these folders meanwhile is forgotten afterwards."""
    before = set(sys.modules)
    try:
        yield
    finally:
        for name in set(sys.modules) - before:
            file = str(getattr(sys.modules[name], "__file__", None))
            if any(file.startswith(f"{folder}{os.sep}") for folder in folders):
                del sys.modules[name]


@pytest.fixture
def install(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> Iterator[Install]:
    """install(package, {module: source}, entry_points) -> folder: a package that this test sees, gone afterwards."""
    folder = tmp_path_factory.mktemp("site-packages")
    monkeypatch.syspath_prepend(str(folder))

    def install(package: str, modules: Mapping[str, str], entry_points: Mapping[str, str]) -> Path:
        files = {f"{name}.py": source for name, source in modules.items()}
        return write_package(folder, package, files, entry_points)

    with forgotten([folder]):
        yield install


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Iterator[None]:
    """What is imported and collected stays to the end: looking through it for garbage is half of the collecting."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Modules with slow tests first: no worker is left alone with one at the end. Modules stay whole, and with them
    what their tests share."""
    slow = {item.path for item in items if item.get_closest_marker("slow")}
    items.sort(key=lambda item: item.path not in slow)


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup() -> None:
    """torch's own random numbers are the same for each test: a new process takes its seed by chance, and which tests a
    worker had before is chance too."""
    if "torch" in sys.modules:
        sys.modules["torch"].manual_seed(0)


@dataclass(frozen=True)
class SmallRun:
    """A finished run of the smallest size, made once per test session; nobody may write into its folder."""

    folder: Path
    command: tuple[str, ...]  # what made it, but for --out

    def summary_of(self, folder: Path | None = None) -> dict[str, Any]:
        """summary.json (of this run, or of another one) without the one number that two equal runs do not share."""
        summary = json.loads(((folder or self.folder) / "summary.json").read_text())
        del summary["wall_seconds"]
        return summary


ONE_BOUND = ("--set", "sweep.kl_bounds=[1.0]")
SMALL = (
    *("--set", "collection.exploring=1", "--set", "measurement.epochs=1", "--set", "finetune.num_envs=2"),
    *("--set", "simulation_test.num_envs=2", "--set", "simulation_test.seconds=3"),
    *("--set", "selection.elites=1", "--set", "evaluation.bootstrap=100"),
)
"""Less of everything than the preset `smoke` has, but for its KL bounds."""
SHORT_BLOCKS = (
    *("--set", "world.block_seconds=3", "--set", "world.warmup_seconds=1", "--set", "world.unsteady_seconds=1"),
)
SMALL_TWIN = (*SHORT_BLOCKS, *SMALL, *ONE_BOUND)
SMALL_RUN = (
    *("run", "--objective", "power", "--robot", "go1", "--preset", "smoke"),
    *("--set", "sweep.weights.power=[1.0, 5.0]", *SMALL_TWIN),
)
"""A run that does everything once, in seconds: 2 candidates, 1 elite, head-to-heads of 12 s."""
SMALL_ORACLE = (
    *("oracle", "--objective", "power", "--robot", "go1", "--preset", "smoke", "--steps", "48"),
    *("--set", "world.reality=dev-03", "--set", "sweep.weights.power=[1.0]", "--set", "finetune.ppo.horizon=12"),
    *(*SHORT_BLOCKS, *SMALL),
)
"""The same of `hts oracle`, on a drawn reality and of one candidate."""


@pytest.fixture(scope="session")
def small() -> Callable[[str], tuple[str, ...]]:
    """small("twin"): settings of `hts run --preset smoke` in that world, for tests that try no sizes."""
    return lambda world: SMALL_TWIN if world == "twin" else (*SMALL, *ONE_BOUND)


@pytest.fixture(scope="session")
def small_run(tmp_path_factory: pytest.TempPathFactory) -> SmallRun:
    """The run that tests copy and break. Workers of one session wait for each other and share it."""
    pytest.importorskip("hts_go1", reason="the robot of this run is not installed")
    pytest.importorskip("hts_power", reason="the objective of this run is not installed")
    return made_once(tmp_path_factory, "small-run", SMALL_RUN)


@pytest.fixture(scope="session")
def oracle_run(tmp_path_factory: pytest.TempPathFactory) -> SmallRun:
    """The same of `hts oracle`; what it printed is in printed.txt beside its folder."""
    pytest.importorskip("hts_go1", reason="the robot of this run comes with it")
    pytest.importorskip("hts_power", reason="the objective of this run comes with it")
    return made_once(tmp_path_factory, "oracle-run", SMALL_ORACLE)


def made_once(tmp_path_factory: pytest.TempPathFactory, name: str, command: tuple[str, ...]) -> SmallRun:
    """The run that this command makes, by the first worker of the session that asks; the others wait for it."""
    workers = "PYTEST_XDIST_WORKER" in os.environ
    place = tmp_path_factory.getbasetemp().parent if workers else tmp_path_factory.getbasetemp()
    folder = place / name / "run"
    folder.parent.mkdir(exist_ok=True)
    with (place / f"{name}.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not (folder / "report.html").exists():
            done = subprocess.run(
                [sys.executable, "-m", "hts.cli.main", *command, "--out", str(folder)],
                capture_output=True,
                text=True,
                timeout=1000,
                check=False,
            )
            assert done.returncode == 0, done.stderr
            folder.with_name("printed.txt").write_text(done.stdout)
    return SmallRun(folder, command)


@pytest.fixture
def broken_run(small_run: SmallRun, tmp_path: Path) -> Path:
    """A copy of the small run, to be broken."""
    return Path(shutil.copytree(small_run.folder, tmp_path / "run"))


@pytest.fixture(scope="session")
def kit_run(tmp_path_factory: pytest.TempPathFactory) -> SmallRun:
    """A run with the kit's plugins, whose world answers at once: for tests of what happens in any world. Nobody may
    write into its folder."""
    from hts.testing.packages import kit_installed
    from hts.testing.tiny_run import tiny_run

    folder = tmp_path_factory.mktemp("kit") / "run"
    with kit_installed(), drawn_quickly():
        tiny_run(folder, settings={"sweep.kl_bounds": [0.5, 2.0], "finetune.steps": 144})
    return SmallRun(folder, ())


@pytest.fixture
def broken_kit_run(kit_run: SmallRun, hts_kit: None, tmp_path: Path) -> Path:
    """A copy of it, to be broken; the kit's plugins are there."""
    return Path(shutil.copytree(kit_run.folder, tmp_path / "run"))


@pytest.fixture
def hts() -> Callable[..., subprocess.CompletedProcess[str]]:
    """hts(*arguments, path=…, cwd=…): the command line in a process of its own, output captured as text."""

    def run(
        *arguments: str | Path,
        path: Sequence[Path] = (),
        cwd: Path | None = None,
        timeout: float = 600.0,
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


@pytest.fixture
def hts_here(capsys: pytest.CaptureFixture[str]) -> Callable[..., subprocess.CompletedProcess[str]]:
    """hts_here(*arguments, path=…): the same in this process, which has loaded torch and the like already. Modules
    below `path` are forgotten afterwards."""

    def run(*arguments: str | Path, path: Sequence[Path] = ()) -> subprocess.CompletedProcess[str]:
        words = [*map(str, arguments)]
        capsys.readouterr()
        with ExitStack() as stack:
            for folder in path:
                stack.enter_context(on_path(folder))
            importlib.invalidate_caches()
            stack.enter_context(forgotten(path))
            status = main(words)
        said = capsys.readouterr()
        return subprocess.CompletedProcess(words, status, said.out, said.err)

    return run
