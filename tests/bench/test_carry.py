"""A folder for a machine without network and git: wheels, benchmarks and entries of a commit, tried before it goes."""

from __future__ import annotations

import os
import subprocess
import sys

import carry
import pytest
import yaml

PROJECT = """
[build-system]
requires = ["hatchling"]
build-backend = "hatchling.build"
[project]
name = "carried"
version = "{version}"
[tool.hatch.build.targets.wheel]
packages = ["carried"]
"""
BENCHMARK = """
import sys
import yaml
from carried import {name}
for rows in yaml.safe_load(open(sys.argv[2]).read()).values():
    for row in rows:
        print({name}, row["realities"], open(row["methods_file"]).read().strip(), *sys.argv[3:4])
"""


def git(repository, *arguments):
    named = ("-c", "user.name=n", "-c", "user.email=n@example.org")
    done = subprocess.run(["git", *named, *arguments], cwd=repository, check=True, capture_output=True, text=True)
    return done.stdout.strip()


def committed(repository, name):
    """A version of the project whose benchmark needs what only its own package has."""
    (repository / "carried").mkdir(exist_ok=True)
    (repository / "benchmarks").mkdir(exist_ok=True)
    (repository / "pyproject.toml").write_text(PROJECT.format(version="1"))
    (repository / "carried" / "__init__.py").write_text(f"{name} = '{name}'\n")
    (repository / "benchmarks" / "realities.py").write_text(BENCHMARK.format(name=name))
    git(repository, "add", "-A")
    git(repository, "commit", "-q", "-m", name)
    return git(repository, "rev-parse", "HEAD")


@pytest.fixture
def repository(tmp_path):
    made = tmp_path / "repository"
    made.mkdir()
    git(made, "init", "-q")
    return made


def batches(tmp_path, *commits):
    path = tmp_path / "several.yaml"
    rows = [
        {"methods": "a", "methods_file": "methods.yaml", "realities": f"one-{index},two-{index}", "commit": commit}
        for index, commit in enumerate(commits)
    ]
    path.write_text(yaml.safe_dump({"batch": rows}))
    return path


def asked(repository, file, out, *more):
    return carry.main([str(file), "--repository", str(repository), "--out", str(out), *more])


def test_each_commit_runs_its_own_benchmarks_with_its_own_packages(tmp_path, repository, capsys):
    older = committed(repository, "older")
    newer = committed(repository, "newer")
    (repository / "methods.yaml").write_text("methods of now\n")
    out = tmp_path / "carried"
    assert asked(repository, batches(tmp_path, older, newer), out) == 0
    assert capsys.readouterr().out.startswith(f"{out}: 2 runs, ")
    shown = subprocess.run(
        [str(out / "start"), "--keep"],
        env={**os.environ, "PYTHON": sys.executable},
        check=True,
        capture_output=True,
        text=True,
        cwd=tmp_path,
    )
    assert shown.stdout.splitlines() == [
        "older one-0,two-0 methods of now --keep",
        "newer one-1,two-1 methods of now --keep",
    ]


def test_what_would_not_start_there_is_not_packed(tmp_path, repository, capsys):
    committed(repository, "older")
    (repository / "benchmarks" / "realities.py").write_text(BENCHMARK.format(name="newer"))
    git(repository, "commit", "-qam", "benchmarks alone")
    (repository / "methods.yaml").write_text("methods\n")
    out = tmp_path / "carried"
    assert asked(repository, batches(tmp_path, git(repository, "rev-parse", "HEAD")), out) == 2
    assert "what was packed does not start: ImportError: cannot import name 'newer'" in capsys.readouterr().err
    assert not out.exists()


@pytest.mark.parametrize(
    ("commit", "more", "message"),
    [
        ("1234567", (), "batch.0: commit is '1234567'. Expected its forty digits."),
        ("0" * 40, (), f"git has no commit {'0' * 40} here"),
        ("0" * 40, ("--realities", "one-0,three"), "no entry names three."),
    ],
)
def test_one_line_for_what_cannot_be_packed(tmp_path, repository, capsys, commit, more, message):
    committed(repository, "older")
    out = tmp_path / "carried"
    assert asked(repository, batches(tmp_path, commit), out, *more) == 2
    error = capsys.readouterr().err
    assert message in error and error.count("\n") == 1
    assert not out.exists()


@pytest.mark.parametrize("order", [1, -1], ids=["file first", "folder first"])
def test_a_file_of_a_folder_that_another_entry_names(tmp_path, repository, order):
    commit = committed(repository, "older")
    (repository / "methods.yaml").write_text("methods\n")
    (repository / "drawn").mkdir()
    for name in ("first", "second"):
        (repository / "drawn" / f"{name}.json").write_text(name)
    path = tmp_path / "several.yaml"
    rows = [
        {"methods": "a", "methods_file": "methods.yaml", "realities": named, "commit": commit}
        for named in ("drawn/first.json", "drawn")
    ]
    path.write_text(yaml.safe_dump({"batch": rows[::order]}))
    assert asked(repository, path, tmp_path / "carried") == 0
    carried = tmp_path / "carried" / commit / "drawn"
    assert {one.name: one.read_text() for one in carried.iterdir()} == {"first.json": "first", "second.json": "second"}


def test_realities_that_are_asked_for_and_no_others(tmp_path):
    found = carry.chosen(batches(tmp_path, "a" * 40, "b" * 40), ["two-1"])
    assert found["batch"] == [
        {"methods": "a", "methods_file": "methods.yaml", "realities": "two-1", "commit": "b" * 40},
    ]


def test_nothing_is_written_over(tmp_path, repository):
    out = tmp_path / "carried"
    out.mkdir()
    with pytest.raises(SystemExit):
        asked(repository, batches(tmp_path, "a" * 40), out)
    assert not list(out.iterdir())
