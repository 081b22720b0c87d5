"""What a release is made of agrees with itself: sentences of the changelog, versions, requirements, what CI runs."""

from __future__ import annotations

import importlib
import re
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml
from packaging.requirements import Requirement
from packaging.specifiers import SpecifierSet
from packaging.utils import canonicalize_name

import hts

REPOSITORY = Path(__file__).resolve().parents[2]
NOT_CHANGES = {"README.md", "template.md.jinja"}
FRAGMENTS = [path for path in sorted((REPOSITORY / "changelog.d").iterdir()) if path.name not in NOT_CHANGES]
PLUGINS = [path for kind in ("plugins", "robots") for path in sorted(REPOSITORY.glob(f"{kind}/*/pyproject.toml"))]
PROJECTS = [REPOSITORY / "pyproject.toml", *PLUGINS]


def read(path: Path) -> dict[str, Any]:
    return tomllib.loads(path.read_text(encoding="utf-8"))


SETTINGS = read(REPOSITORY / "pyproject.toml")
KINDS = [kind["directory"] for kind in SETTINGS["tool"]["towncrier"]["type"]]


def of_project(path: Path) -> str:
    """plugins/power for its pyproject.toml; "." for the root's."""
    return str(path.parent.relative_to(REPOSITORY))


# ------------------------------------------------------------------------------------------------- the changelog


def faults(name: str, text: str) -> Iterator[str]:
    """What is wrong with a file of changelog.d."""
    if not re.fullmatch(rf"[a-z0-9-]+\.({'|'.join(KINDS)})(\.\d+)?\.md", name):
        yield f"{name}: expected TOPIC.KIND.md, KIND one of {', '.join(KINDS)}"
    if not text.strip().endswith("."):
        yield f"{name}: expected one or two sentences, with a full stop"
    if re.match(r"\s*[-*#] ", text):
        yield f"{name}: expected plain sentences, without a bullet or a heading"


def test_a_change_is_a_sentence_in_a_file_named_for_it():
    found = [fault for path in FRAGMENTS for fault in faults(path.name, path.read_text(encoding="utf-8"))]
    assert not found, "\n".join(found)


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("speed.md", "Faster."),
        ("speed.improved.md", "Faster."),
        ("Speed.added.md", "Faster."),
        ("speed.added.rst", "Faster."),
        ("speed.added.md", ""),
        ("speed.added.md", "faster"),
        ("speed.added.md", "- Faster."),
    ],
)
def test_a_change_that_the_changelog_would_lose_or_garble_is_seen(name, text):
    assert len(list(faults(name, text))) == 1


def test_a_second_change_of_one_topic_and_kind_has_a_number():
    assert list(faults("speed.added.2.md", "Faster again.")) == []


def test_the_next_changelog_has_every_sentence(tmp_path):
    command = [sys.executable, "-m", "towncrier", "build", "--draft", "--version", "next", "--dir", str(REPOSITORY)]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    written = " ".join(done.stdout.split())
    missing = [path.name for path in FRAGMENTS if " ".join(path.read_text(encoding="utf-8").split()) not in written]
    assert missing == []


# ------------------------------------------------------------------------------------------------- versions


@pytest.mark.parametrize("path", PROJECTS, ids=of_project)
def test_a_distribution_takes_its_version_from_hts(path):
    project = read(path)
    assert "version" not in project["project"]
    assert project["project"]["dynamic"] == ["version"]
    source = path.parent / project["tool"]["hatch"]["version"]["path"]
    assert source.resolve() == REPOSITORY / "hts" / "__init__.py"


@pytest.mark.parametrize("path", PLUGINS, ids=of_project)
def test_a_plugin_asks_for_the_hts_of_its_own_version(path):
    (wanted,) = [Requirement(line) for line in read(path)["project"]["dependencies"] if line.startswith("hard-to-sim")]
    major, minor, _ = (int(number) for number in hts.__version__.split("."))
    assert wanted.specifier == SpecifierSet(f">={major}.{minor},<{major}.{minor + 1}")


@pytest.mark.parametrize("path", [*PROJECTS, REPOSITORY / "integrations" / "rsl_rl" / "pyproject.toml"], ids=of_project)
def test_a_distribution_says_what_an_index_shows(path):
    """One that is installed alone has its own copies: nothing outside its folder is in its wheel."""
    project, root = read(path)["project"], SETTINGS["project"]
    assert {"description", "keywords", "classifiers"} <= set(project)
    assert (project["license"], project["license-files"]) == (root["license"], ["LICENSE"])
    assert (path.parent / "LICENSE").read_bytes() == (REPOSITORY / "LICENSE").read_bytes()
    text = (path.parent / project["readme"]).read_text(encoding="utf-8")
    assert text.startswith(f"# {project['name']}\n")
    citation = yaml.safe_load((REPOSITORY / "CITATION.cff").read_text(encoding="utf-8"))
    assert project["authors"] == citation["authors"]
    assert project["urls"] == {"Paper": citation["preferred-citation"]["url"]}
    supported = SpecifierSet(project["requires-python"])
    said = {line.rsplit(" ", 1)[1] for line in project["classifiers"] if line.startswith("Programming Language")} - {
        "3"
    }
    assert said == {"3.11", "3.12"} and all(supported.contains(one) for one in said)
    assert not any(line.startswith("License") for line in project["classifiers"]), "`license` says it"


def test_make_builds_every_distribution():
    (line,) = re.findall(r"^DISTRIBUTIONS := (.*)$", (REPOSITORY / "Makefile").read_text(), re.MULTILINE)
    assert set(line.split()) == {of_project(path) for path in PROJECTS}


def test_the_page_of_versions_names_what_is_in_the_code():
    named = re.findall(r"`(hts\.[a-z_.]+)\.([A-Z_]+)`", (REPOSITORY / "docs" / "versions.md").read_text())
    assert len(named) >= 4
    for module, constant in named:
        assert isinstance(getattr(importlib.import_module(module), constant), int), f"{module}.{constant}"


# ------------------------------------------------------------------------------------------------- requirements


def pins() -> dict[str, str]:
    """Canonical name -> version, from constraints.txt."""
    lines = (REPOSITORY / "constraints.txt").read_text(encoding="utf-8").splitlines()
    pairs = [line.split("==") for line in lines if line and not line.startswith("#")]
    return {str(canonicalize_name(name)): version for name, version in pairs}


@pytest.mark.parametrize("path", PROJECTS, ids=of_project)
def test_every_requirement_is_pinned_within_its_bounds(path):
    project, pinned = read(path), pins()
    lines = [*project["project"].get("dependencies", []), *project["build-system"]["requires"]]
    for extra in project["project"].get("optional-dependencies", {}).values():
        lines += extra
    for wanted in map(Requirement, lines):
        if not wanted.name.startswith("hard-to-sim"):
            version = pinned.get(str(canonicalize_name(wanted.name)), "nothing")
            assert version != "nothing" and wanted.specifier.contains(version), f"{wanted}, constraints.txt: {version}"


# ------------------------------------------------------------------------------------------------- what is run


def test_ci_runs_what_a_laptop_runs_on_every_python_that_is_supported():
    jobs = yaml.safe_load((REPOSITORY / ".github" / "workflows" / "ci.yml").read_text())["jobs"]
    supported = SpecifierSet(SETTINGS["project"]["requires-python"])
    versions = {f"3.{minor}" for minor in range(20) if supported.contains(f"3.{minor}")}
    assert {job: set(body["strategy"]["matrix"]["python"]) for job, body in jobs.items()} == {
        "check": versions,
        "wheels": versions,
    }
    commands = {job: [step["run"] for step in body["steps"] if "run" in step] for job, body in jobs.items()}
    assert commands == {"check": [".ci/run"], "wheels": ["make smoke-wheels"]}


def test_hooks_before_a_commit_fetch_nothing_and_use_the_pinned_tools():
    configured = yaml.safe_load((REPOSITORY / ".pre-commit-config.yaml").read_text())["repos"]
    assert [repository["repo"] for repository in configured] == ["local"]
    for hook in configured[0]["hooks"]:
        assert hook["language"] == "system"
        assert hook["entry"].startswith(".venv/bin/"), hook["entry"]
    (looked_at,) = (hook["files"] for hook in configured[0]["hooks"] if hook["id"] == "changelog")
    read_here = ("Makefile", ".github/workflows/ci.yml", ".pre-commit-config.yaml", "docs/versions.md", "CITATION.cff")
    for file in (*read_here, "constraints.txt", "hts/__init__.py", "plugins/power/pyproject.toml", "changelog.d/a.md"):
        assert re.match(looked_at, file), f"{file} may be changed without a look at this file's tests"


def test_a_citation_names_the_paper_of_the_method():
    citation = yaml.safe_load((REPOSITORY / "CITATION.cff").read_text(encoding="utf-8"))
    assert {"cff-version", "message", "title", "authors"} <= set(citation)
    assert "version" not in citation, "hts/__init__.py alone states it"
    assert "arXiv:2502.10956" in citation["preferred-citation"]["journal"]
    assert citation["license"] == SETTINGS["project"]["license"]
