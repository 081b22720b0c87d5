"""What `hts new` writes: installed by pip as it is, checked, tested and run."""

from __future__ import annotations

import errno
import json
import os
import re
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest

from hts.errors import ConfigError, RunError
from hts.recordings import RecordingStore
from hts.testing.starters import STARTERS, write_starter

NAMES = {
    "objective": "heat",
    "measurement-model": "thermal",
    "robot": "hopper",
    "log-only-robot": "rover",
    "world": "cellar",
    "instrument": "thermometer",
    "selector": "steady",
    "reader": "diary",
}

PAGES = Path(__file__).parents[2] / "docs" / "authors"
CHECK = "$ hts check hts-heat\n...\nhts-heat: … checks, 0 failed\n"
TESTS = "$ python -m pytest -q hts-heat\n...\n3 passed…"
THERMAL = "$ hts check --quiet hts-thermal\nhts-thermal: … checks, 0 failed\n"
SHOWN = {"objective": ("tutorial", CHECK, TESTS), "measurement-model": ("measurement-model", THERMAL)}
"""Kind -> a page, and what it shows of what `hts new` wrote: tests/house/test_docs_examples.py types it."""


def python(
    *arguments: str | Path, path: Sequence[Path] = (), cwd: Path | None = None
) -> subprocess.CompletedProcess[str]:
    searched = [*map(str, path), os.environ.get("PYTHONPATH", "")]
    env = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, searched))}
    return subprocess.run(
        [sys.executable, *map(str, arguments)], capture_output=True, text=True, check=False, cwd=cwd, env=env
    )


@pytest.fixture(scope="module")
def site(tmp_path_factory) -> Path:
    """A folder into which pip installed the packages, built from what `hts new` wrote into an empty one."""
    empty, site = tmp_path_factory.mktemp("empty"), tmp_path_factory.mktemp("site-packages")
    folders = [write_starter(kind, name, empty) for kind, name in NAMES.items()]
    quick = ("--quiet", "--no-deps", "--no-build-isolation", "--no-index", "--disable-pip-version-check")
    done = python("-m", "pip", "install", *quick, "--target", site, *folders)
    assert done.returncode == 0, done.stderr
    return site


def test_pip_installs_everything_that_is_needed(site):
    assert (site / "hts_hopper" / "policies" / "pretrained.safetensors").is_file()
    code = (
        "import json; from hts.plugins import load; r = load(); print(json.dumps("
        "[r.objectives['heat'].package, r.instruments['heat_meter'].package, r.robots['hopper'].package,"
        " r.measurement_models['thermal'].package, r.selectors['steady'].package, r.robots['rover'].package,"
        " r.worlds['cellar'].package, r.instruments['thermometer'].package, r.log_readers['diary'].package,"
        " [b.package for b in r.broken]]))"
    )
    done = python("-c", code, path=[site])
    assert json.loads(done.stdout) == [
        *("hts-heat", "hts-heat", "hts-hopper", "hts-thermal", "hts-steady"),
        *("hts-rover", "hts-cellar", "hts-thermometer", "hts-diary"),
        [],
    ]


@pytest.mark.parametrize("kind", SHOWN)
def test_the_page_of_those_that_are_tried_there_types_it(kind):
    page, *shown = SHOWN[kind]
    text = (PAGES / f"{page}.md").read_text(encoding="utf-8")
    assert f"$ hts new {kind} {NAMES[kind]}\n" in text
    assert all(lines in text for lines in shown)


@pytest.mark.parametrize("kind", sorted(NAMES.keys() - SHOWN.keys()))
def test_it_passes_the_check(kind, site, hts_here):
    done = hts_here("check", f"hts-{NAMES[kind]}", path=[site])
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.splitlines()[-1].endswith("checks, 0 failed")


@pytest.mark.slow
def test_their_own_tests_are_green(site):
    """In one process, which loads torch and the like once for all. Those of the objective run alone, on its page."""
    empty = next(site.parent.glob("empty*")).resolve()  # one of them is a link to the other
    names = [name for kind, name in NAMES.items() if kind != "objective"]
    options = ("-q", "-rA", "-p", "no:cacheprovider", "-p", "quick_figures", "--rootdir", empty)
    folders = (empty / f"hts-{name}" for name in names)
    done = python("-m", "pytest", *options, *folders, path=[site, Path(__file__).parents[1]], cwd=empty)
    assert done.returncode == 0, done.stdout + done.stderr
    passed = set(re.findall(r"^PASSED hts-([a-z]+)/tests/", done.stdout, re.MULTILINE))
    assert passed == set(names), done.stdout


def test_the_tests_of_a_robot_without_a_policy_skip_what_needs_one(tmp_path):
    folder = write_starter("robot", "hopper", tmp_path)
    file = folder / "hts_hopper" / "robot.py"
    source = file.read_text()
    assert "return self.settings.policy or POLICY" in source
    file.write_text(source.replace("return self.settings.policy or POLICY", "return self.settings.policy"))
    command = ("-m", "pytest", "-q", "-rs", "-p", "no:cacheprovider", "-k", "not contracts", folder)
    done = python(*command, path=[folder], cwd=folder)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "3 skipped, 1 deselected" in done.stdout
    assert "the robot ships no policy yet" in done.stdout


@pytest.mark.slow
def test_all_of_them_run_smoke_together(site, hts_here, small, tmp_path):
    command = ["run", "--objective", "heat", "--robot", "hopper", "--preset", "smoke", "--out", tmp_path / "run"]
    chosen = ("--set", "selection.selector.name=steady", "--set", "objectives.heat.model=thermal")
    carried = ("--set", "world.instruments.thermometer.noise=0.1")  # beside the objective's own
    done = hts_here(*command, *chosen, *carried, *small("twin"), path=[site])
    assert done.returncode == 0, done.stderr
    summary = json.loads((tmp_path / "run" / "summary.json").read_text())
    assert (summary["objectives"], summary["robot"], summary["world"]) == (["heat"], "hopper", "twin")
    tested = [candidate["real"] for candidate in summary["iterations"][0]["candidates"] if candidate["elite"]]
    assert tested and all(real is not None and real["heat"]["0.8"]["segments"] > 0 for real in tested)
    assert (tmp_path / "run" / "report.html").is_file()
    card = json.loads((tmp_path / "run" / "iterations" / "00" / "models" / "heat.json").read_text())
    assert (card["model"], card["version"]) == ("thermal", 2)
    store = RecordingStore(tmp_path / "run" / "data.zarr")
    assert all("thermometer_reading" in store.attributes(name)["idle"] for name in store.ids())


@pytest.mark.slow
def test_a_world_as_written_runs_smoke(site, hts_here, small, tmp_path):
    """The world carries the objective's instrument; the model is another one than the objective asks for."""
    command = ["run", "--objective", "heat", "--robot", "hopper", "--preset", "smoke"]
    command += ["--set", "objectives.heat.model=linear"]
    done = hts_here(*command, *small("cellar"), "--world", "cellar", "--out", tmp_path / "cellar", path=[site])
    assert done.returncode == 0, done.stderr
    summary = json.loads((tmp_path / "cellar" / "summary.json").read_text())
    assert summary["world"] == "cellar"
    fitted = json.loads((tmp_path / "cellar" / "iterations" / "00" / "fit.json").read_text())
    assert fitted["heat"]["model"]["name"] == "linear"
    tested = [candidate["real"] for candidate in summary["iterations"][0]["candidates"] if candidate["elite"]]
    assert tested and all(real is not None and real["heat"]["0.8"]["segments"] > 0 for real in tested)


@pytest.mark.parametrize(
    ("package", "log", "robot"), [("rover", "walk.csv", "rover"), ("diary", "walk.jsonl", "rover")]
)
def test_logs_are_imported_and_a_model_is_fitted_by_the_commands(package, log, robot, site, hts_here, tmp_path):
    folder = next(site.parent.glob(f"empty*/hts-{package}"))
    mapping = (folder / "mapping.yaml").read_text().replace("supply: ", "heat_level: ").replace("unit: A,", "unit: W,")
    (tmp_path / "mapping.yaml").write_text(mapping)
    store = tmp_path / "data.zarr"
    words = ("--robot", robot, "--mapping", tmp_path / "mapping.yaml", "--to", store)
    done = hts_here("import", folder / log, *words, path=[site])
    assert done.returncode == 0, done.stderr
    assert "20.00 s at 50 Hz, joint_torque, joint_velocity, heat_level" in done.stdout
    quick = ("--set", "measurement.epochs=2")
    done = hts_here("fit", "--objective", "heat", "--data", store, "--out", tmp_path / "fit", *quick, path=[site])
    assert done.returncode == 0, done.stderr
    assert json.loads((tmp_path / "fit" / "fit.json").read_text())["target"] == "heat_level"


@pytest.mark.slow
def test_a_measurement_model_as_written_runs_smoke_with_our_own_objective_and_robot(site, hts_here, tmp_path):
    pytest.importorskip("hts_go1", reason="the robot of this run is not installed")
    pytest.importorskip("hts_power", reason="the objective of this run is not installed")
    command = ["run", "--objective", "power", "--set", "objectives.power.model=thermal", "--robot", "go1"]
    done = hts_here(*command, "--preset", "smoke", "--out", tmp_path / "run", path=[site])
    assert done.returncode == 0, done.stderr
    assert "report: " in (done.stdout + done.stderr).splitlines()[-1]  # as docs/authors/measurement-model.md shows it
    report = json.loads((tmp_path / "run" / "iterations" / "00" / "fit.json").read_text())["power"]
    assert report["model"]["name"] == "thermal"
    assert report["held_out"]["linear"]["r2"] is not None and report["held_out"]["spread"] is not None


@pytest.mark.parametrize("name", ["heat", "a_rather_long_name_of_something", "step-noise"])
def test_they_are_formatted_and_linted_by_their_own_settings(name, tmp_path):
    """ruff reads the settings that lie nearest to each file: those of its package."""
    folders = [write_starter(kind, name, tmp_path / kind) for kind in NAMES]
    assert all("[tool.ruff" in (folder / "pyproject.toml").read_text() for folder in folders)
    for command in (["check", "--no-cache"], ["format", "--check", "--no-cache"]):
        done = python("-m", "ruff", *command, *folders, cwd=tmp_path)
        assert done.returncode == 0, done.stdout + done.stderr


def test_the_objective_is_short_and_nothing_of_the_example_is_left(tmp_path):
    for kind, starter in STARTERS.items():
        folder, own = write_starter(kind, NAMES[kind], tmp_path), starter.own
        for path in folder.glob("hts_*/*.py"):
            text = path.read_text()
            assert own not in text.lower() and "hts.testing" not in text, path
    assert len((tmp_path / "hts-heat" / "hts_heat" / "objective.py").read_text().splitlines()) <= 100


def test_the_shipped_policy_is_the_one_that_is_written_down(tmp_path):
    """Also of the kit's own robot, whose files are in the repository."""
    import torch

    from hts.policies.files import load_policy
    from hts.testing.examples.robot.robot import POLICY, SPEC

    write_starter("robot", "hopper", tmp_path)
    shipped = load_policy(POLICY, SPEC)
    written = load_policy(tmp_path / "hts-hopper" / "hts_hopper" / "policies" / "pretrained.safetensors")
    assert (shipped.card.robot, written.card.robot) == ("tiny", "hopper")
    for name, value in shipped.tensors.items():
        assert torch.allclose(value, written.tensors[name], rtol=1e-5, atol=1e-6), name


def test_the_shipped_policy_is_exported_and_has_room_to_learn(tmp_path):
    """A step of 1e-3 in every weight, a few of the optimiser's, moves actions by less than the exploration noise."""
    import numpy as np
    import torch

    from hts.policies.export_checks import random_observations
    from hts.policies.export_command import export_policy
    from hts.policies.files import load_policy
    from hts.rl.population import Population
    from hts.testing.examples.robot.robot import POLICY

    for kind in ("onnx", "torchscript"):
        export_policy(None, str(POLICY), kind, tmp_path / kind)  # raises for actions that are off by 1e-5
    policy = load_policy(POLICY)
    seen = torch.from_numpy(np.clip(random_observations(policy), -3.0, 3.0))[None]
    population = Population.from_candidates(policy.card.sizes(), [policy.tensors])
    with torch.no_grad():
        before = population.mean(seen)
        population.vectors[0] += 1e-3 * torch.sign(
            torch.randn(population.vectors[0].shape, generator=torch.Generator().manual_seed(0))
        )
        population.refresh()
        assert float((population.mean(seen) - before).abs().mean()) < 0.5


def test_nothing_is_overwritten(tmp_path):
    write_starter("selector", "steady", tmp_path)
    with pytest.raises(RunError, match="exists already"):
        write_starter("selector", "steady", tmp_path)


@pytest.mark.parametrize(("kind", "failing"), [("selector", "write_text"), ("robot", "save_policy")])
def test_a_disk_that_fills_up_leaves_no_half_of_a_package(tmp_path, monkeypatch, kind, failing):
    def full(path, *_, **__):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path))

    with monkeypatch.context() as patch:
        if failing == "write_text":
            written, write_text = [], Path.write_text
            patch.setattr(
                Path,
                "write_text",
                lambda self, *args, **options: (
                    full(self) if len(written) == 3 else (written.append(self), write_text(self, *args, **options))
                ),
            )
        else:
            patch.setattr("hts.policies.files.save_policy", full)
        with pytest.raises(RunError, match="hts-steady: cannot be written .No space left on device.*--to DIR"):
            write_starter(kind, "steady", tmp_path / "there")
    assert list((tmp_path / "there").iterdir()) == []
    folder = write_starter(kind, "steady", tmp_path / "there")
    assert (folder / "pyproject.toml").is_file() and [path.name for path in folder.parent.iterdir()] == ["hts-steady"]


@pytest.mark.parametrize("name", ["Hopper", "2legs", "my--robot", "class", "", "two__lines", "a_", "a-"])
def test_a_name_that_python_cannot_import_is_refused(name, tmp_path):
    with pytest.raises(ConfigError, match="cannot name a robot"):
        write_starter("robot", name, tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_a_name_that_is_too_long_is_refused(tmp_path):
    with pytest.raises(ConfigError, match="has 51 characters, expected 50 at most"):
        write_starter("robot", "r" * 51, tmp_path)
    assert write_starter("robot", "r" * 50, tmp_path).is_dir()


@pytest.mark.parametrize(("kind", "name"), [("robot", "tiny"), ("objective", "fake"), ("selector", "hierarchical")])
def test_a_name_that_is_taken_is_refused(kind, name, tmp_path):
    with pytest.raises(ConfigError, match=f"'{name}' is taken"):
        write_starter(kind, name, tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_a_robot_known_by_its_logs_is_an_option_of_robots(tmp_path, hts):
    done = hts("new", "robot", "rover", "--log-only", "--to", "there", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1] == (
        "then: hts import there/hts-rover/walk.csv --robot rover --mapping there/hts-rover/mapping.yaml --to data.zarr"
    )
    assert "LogOnlyRobot" in (tmp_path / "there/hts-rover/hts_rover/plugin.py").read_text()
    with pytest.raises(ConfigError, match="--log-only is for robots"):
        write_starter("world", "cellar", tmp_path, log_only=True)
    with pytest.raises(ConfigError, match="'tiny' is taken: .* offers the robot"):
        write_starter("robot", "tiny", tmp_path, log_only=True)


def test_an_objective_gets_its_article(tmp_path):
    with pytest.raises(ConfigError, match="cannot name an objective"):
        write_starter("objective", "Heat", tmp_path)


def test_a_name_with_a_hyphen_is_the_name_and_its_modules_have_an_underscore(tmp_path, hts_here):
    """`hts check` takes such names, so `hts new` does."""
    from hts.testing.packages import write_package

    folder = write_starter("objective", "step-noise", tmp_path)
    assert folder.name == "hts-step-noise"
    assert (folder / "tests" / "test_step_noise.py").is_file()
    site = write_package(tmp_path / "site", "hts-step-noise", {}, {"step-noise": "hts_step_noise.plugin"})
    done = hts_here("check", "hts-step-noise", "--quiet", path=[folder, site])
    assert done.returncode == 0, done.stdout + done.stderr


def test_a_misspelt_kind_is_answered_with_the_closest(tmp_path):
    with pytest.raises(ConfigError, match="Did you mean 'objective'"):
        write_starter("objectiv", "heat", tmp_path)


def test_the_command_says_what_to_do_next(hts, tmp_path):
    done = hts("new", "selector", "steady", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines() == [
        "hts-steady",
        "next: pip install -e hts-steady && hts check hts-steady && python -m pytest hts-steady",
        "then: hts run --objective OBJECTIVE --robot ROBOT --preset smoke --set selection.selector.name=steady",
    ]


@pytest.mark.parametrize(
    ("kind", "name"), [("measurement-model", "power"), ("instrument", "noise"), ("selector", "go1")]
)
def test_a_name_whose_module_is_installed_already_is_refused(tmp_path, kind, name):
    pytest.importorskip(f"hts_{name}", reason="this package is not installed")
    with pytest.raises(ConfigError, match=rf"'{name}' is taken: a module hts_{name} is installed.*such as {name}-"):
        write_starter(kind, name, tmp_path)
    assert not list(tmp_path.iterdir())
