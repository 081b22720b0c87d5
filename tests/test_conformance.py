"""The kit for plugin authors, tried on our own plugins, on what `hts new` writes, and on faulty ones."""

from __future__ import annotations

import subprocess
import sys

import pytest

from hts.errors import ConfigError, RunError
from hts.plugins import load
from hts.testing.conformance import check_package
from hts.testing.starters import write_starter

OURS = ["hard-to-sim", "hard-to-sim-power", "hard-to-sim-noise", "hard-to-sim-go1"]


def faults(package: str) -> dict[str, str]:
    """Subject and demand -> fault, of everything that is not kept."""
    return {f"{f.subject}: {f.demand}": f.fault for f in check_package(load(), package) if f.fault is not None}


@pytest.mark.parametrize("package", OURS)
def test_our_own_plugins_keep_the_contracts(package):
    assert faults(package) == {}


@pytest.fixture
def starter(tmp_path, install, monkeypatch):
    """starter(kind, before, after) -> the faults of a package by `hts new`, with one text in it replaced by another."""

    def made(kind: str, before: str = "", after: str = "") -> dict[str, str]:
        folder = write_starter(kind, "my_heat", tmp_path)
        file = folder / "hts_my_heat" / f"{kind}.py"
        source = file.read_text()
        assert before in source
        file.write_text(source.replace(before, after) if before else source)
        install("hts-my-heat", {}, {"my_heat": "hts_my_heat.plugin"})
        monkeypatch.syspath_prepend(str(folder))
        monkeypatch.setenv("PYTHONPATH", str(folder))  # for what is tried in a process of its own
        assert len(check_package(load(), "hts-my-heat")) > 2
        return faults("hts-my-heat")

    yield made
    for name in [name for name in sys.modules if name.startswith("hts_my_heat")]:
        del sys.modules[name]


@pytest.mark.parametrize("kind", ["objective", "robot", "selector"])
def test_what_hts_new_writes_keeps_the_contracts(kind, starter):
    assert starter(kind) == {}


def test_what_hts_new_writes_is_formatted(tmp_path):
    folders = [write_starter(kind, f"some_{kind}", tmp_path) for kind in ("objective", "robot", "selector")]
    for command in (["check", "--extend-select", "I,B,UP"], ["format", "--check"]):
        options = ["--isolated", "--line-length", "120", "--target-version", "py311"]
        done = subprocess.run(
            [sys.executable, "-m", "ruff", *command, *options, *map(str, folders)],
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 0, done.stdout + done.stderr


def test_hts_new_overwrites_nothing(tmp_path):
    write_starter("robot", "hopper", tmp_path)
    with pytest.raises(RunError, match="exists already"):
        write_starter("robot", "hopper", tmp_path)


@pytest.mark.parametrize("name", ["Hopper", "2legs", "my-robot", "class", ""])
def test_hts_new_refuses_a_name_that_python_cannot_import(name, tmp_path):
    with pytest.raises(ConfigError, match="cannot name a robot"):
        write_starter("robot", name, tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_hts_new_answers_a_misspelt_kind_with_the_closest(tmp_path):
    with pytest.raises(ConfigError, match="Did you mean 'objective'"):
        write_starter("objectiv", "heat", tmp_path)


def test_a_package_that_is_not_installed_is_answered_with_the_closest():
    with pytest.raises(ConfigError, match="Did you mean 'hard-to-sim'"):
        check_package(load(), "hard-to-simm")


def test_a_broken_package_is_a_finding(install):
    install("stranger", {"stranger": "import no_such_library"}, {"odd": "stranger"})
    assert list(faults("stranger").values()) == ["ModuleNotFoundError: No module named 'no_such_library'"]


@pytest.mark.parametrize(
    ("kind", "before", "after", "fault"),
    [
        ("objective", "return -prediction", "return -prediction.mean()", "prediction (3, 4) gives ()"),
        ("objective", "return -prediction", "return prediction * 0", "is the same for every prediction"),
        ("objective", 'name = "my_heat"', 'name = "heat"', "is registered as 'my_heat' but calls itself 'heat'"),
        ("objective", ".mean(axis=1)", ".mean()", "score 'gross' has shape ()"),
        ("objective", "1.0 - policy", "2.0 - policy", "a policy equal to its reference improves by 1.0"),
        (
            "objective",
            "{TARGET.name: self.level}",
            "{TARGET.name: self.level[:1]}",
            "'my_heat' has shape (1,), not (3,)",
        ),
        ("objective", "return {TARGET.name: self.level}", "return {}", "read() gives []"),
        ("objective", "class Settings(Config):", "class Settings(Config, extra='ignore'):", "takes any setting"),
        ("robot", "kp=(20.0, 20.0)", "kp=(20.0,)", "spec.kp has 1 entries for 2 joints"),
        ("robot", "substeps=4", "substeps=5", "is not 1 / control_rate_hz"),
        ("robot", "default_pose=(0.0, 0.5)", "default_pose=(0.0, 2.5)", "default pose of 'knee' is 2.5 rad"),
        ("selector", "key=rank)[:count]", "key=rank)", "elites are"),
    ],
)
def test_a_fault_is_found(starter, kind, before, after, fault):
    found = starter(kind, before, after)
    assert any(fault in text for text in found.values()), found
