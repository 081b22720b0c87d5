"""What the pages say exists, exists; what they show works."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from hts.cli.commands import COMMANDS
from hts.plugins import load

REPOSITORY = Path(__file__).resolve().parent.parent
PAGES = [REPOSITORY / "README.md", *sorted((REPOSITORY / "docs").glob("*.md"))]
LINK = re.compile(r"\]\(([^)#\s]+)[^)]*\)")


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_link_to_a_file_leads_somewhere(page):
    links = [link for link in LINK.findall(page.read_text()) if not link.startswith("http")]
    assert [link for link in links if not (page.parent / link).exists()] == []


def test_every_page_is_in_the_index():
    listed = set(LINK.findall((REPOSITORY / "docs/index.md").read_text()))
    assert {page.name for page in (REPOSITORY / "docs").glob("*.md")} - {"index.md"} == listed


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_command_that_a_page_names_exists(page):
    named = set(re.findall(r"(?:`|\n\s+|bin/)hts ([a-z][a-z-]*)", page.read_text()))
    assert named - set(COMMANDS) - set(load().commands) == set()


def test_the_objective_of_the_manual_loads_and_compares(install):
    text = (REPOSITORY / "docs/plugins.md").read_text()
    (code,) = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    install("hts-heat", {"hts_heat": code}, {"heat": "hts_heat"})
    registry = load()
    assert registry.objectives["heat"].package == "hts-heat"
    objective = registry.make_objective("heat")
    assert objective.measurement_model().target == "motor_heat"
    compared = objective.compare({"heat": 30.0}, {"heat": 40.0})
    assert (compared.improvement, compared.selection_score) == (10.0, 10.0)
