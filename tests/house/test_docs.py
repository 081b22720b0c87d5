"""What the pages say exists, exists; what they show works."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path
from pkgutil import resolve_name

import pytest

from hts.cli.commands import COMMANDS
from hts.config import CollectionConfig, CommandConfig, EnvConfig, PPOConfig, TrustRegionConfig
from hts.config_gate import GateConfig
from hts.config_loading import load_config
from hts.envs import rewards
from hts.evaluation.held import not_held_in_training
from hts.plugins import load
from hts.presets import PRESETS
from hts.run import trust_region

REPOSITORY = Path(__file__).resolve().parents[2]
DOCS = REPOSITORY / "docs"
ROOT_PAGES = [REPOSITORY / name for name in ("README.md", "CONTRIBUTING.md", "SECURITY.md", "CHANGELOG.md")]
PAGES = [*ROOT_PAGES, *sorted(DOCS.glob("*.md")), *sorted(DOCS.glob("authors/*.md"))]
LINK = re.compile(r"\]\(([^)#\s]+)[^)]*\)")


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_link_to_a_file_leads_somewhere(page):
    links = [link for link in LINK.findall(page.read_text()) if not link.startswith("http")]
    assert [link for link in links if not (page.parent / link).exists()] == []


# What a reader makes in a folder of their own.
THEIRS = {"authors/tutorial.md": {"tests/test_heat.py"}}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_file_that_a_page_names_is_there(page):
    text = page.read_text()
    folders = "hts|tests|docs|plugins|robots|benchmarks|examples"
    named = set(re.findall(rf"(?<![\w/.-])((?:{folders})/[\w./-]+\.(?:py|json|md|yaml)\b)", text))
    theirs = THEIRS.get(str(page.relative_to(DOCS)) if page.is_relative_to(DOCS) else "", set())
    assert {name for name in named - theirs if not (REPOSITORY / name).exists()} == set()


def test_everything_of_ours_that_a_page_names_can_be_imported():
    for page in PAGES:
        for name in set(re.findall(r"`(hts(?:\.(?!json)[A-Za-z_]\w*)+)[`(]", page.read_text())):
            resolve_name(name)  # raises for what is not there


def test_the_file_for_a_robot_of_another_size_holds_settings_and_what_the_presets_have_instead(tmp_path):
    page = (DOCS / "your-robot.md").read_text()
    (text,) = re.findall(r'^```yaml title="small.yaml"\n(.*?)^```$', page, re.MULTILINE | re.DOTALL)
    (tmp_path / "small.yaml").write_text(text)
    small, quick = load_config(file=tmp_path / "small.yaml", objectives=["power"]), PRESETS["quick"]
    low, high = small.finetune.env.commands.vx
    assert all(low < speed < high for speed in small.evaluation.speeds)
    assert small.finetune.ppo.gamma == pytest.approx(
        quick["finetune"]["ppo"].get("gamma", PPOConfig().gamma) ** 0.5, abs=1e-4
    )
    for preset in (quick, PRESETS["paper"]):
        env = preset["finetune"]["env"]
        assert env["commands"]["vx"] == [0.2, 1.5] and preset["evaluation"]["speeds"] == [0.5, 0.8, 1.1]
        assert env["randomisation"]["added_mass"] == [-1.0, 3.0] == list(GateConfig().payload)
        assert env["randomisation"]["push_speed"] == 0.8 and env["reward_weights"]["termination"] == -500.0
        told = CommandConfig.model_validate(env["commands"])
        assert f"command below {told.stand_below:g} m/s (`stand_below`) is one to stand" in page
        assert f"forward commands below {told.held_from:g} m/s (`held_from`) are left out" in page
    assert not_held_in_training(small, load().make_robot("go1")) is None


def test_the_settings_that_the_pages_state_are_those_of_the_code():
    training, twin = ((DOCS / f"{name}.md").read_text() for name in ("training", "twin"))
    env, longest = EnvConfig(), EnvConfig().randomisation.delay_steps[1]
    low, high = env.commands.vx
    assert f"Forward {low:g} to {high:g} m/s".replace("-", "−") in training
    assert f"actuation delay of 0 to {longest} physics steps" in training
    assert f"| delay | 0 to {longest} steps of 5 ms |" in twin
    rates = [PRESETS[name]["finetune"]["ppo"]["learning_rate"] for name in ("quick", "paper")]
    assert rates == [1e-4, 1e-4]
    assert "rate 10⁻⁴ in presets `quick` and `paper` (3·10⁻⁴ where nothing is set)" in training
    assert PPOConfig().learning_rate == 3e-4
    region, most = TrustRegionConfig(), PRESETS["paper"]["sweep"]["trust_region"]["most"]
    assert (region.shrink, region.grow, region.grow**2) == (0.5, 2.0, 4.0)
    assert f"whole interval is below {region.agreement:g} (`agreement`)" in training
    assert (
        f"was above {trust_region.ACTIVE:g} of its bound | 2 (`grow`); 4 if it is above {region.close:g} (`close`)"
        in training
    )
    assert f"leaves {region.least:g} to {region.most:g} nats (`least`, `most`; {most:g} in `paper`)" in training
    (quick,), (paper,) = (PRESETS[name]["sweep"]["kl_bounds"] for name in ("quick", "paper"))
    assert f"`quick` begins with {quick:g} nats, `paper` with {paper:g}" in training
    assert f"a prior worth {trust_region.PRIOR_ELITES} elites".replace("4", "four") in training
    first = {name: CollectionConfig.model_validate(PRESETS[name]["collection"]) for name in ("quick", "paper")}
    assert {(one.repeats, one.exploring, one.exploration) for one in first.values()} == {(2, 6, 0.3)}
    assert {tuple(part.vx for part in one.schedule.commands) for one in first.values()} == {(0.3, 0.5, 0.8, 1.1, 1.3)}
    quick, paper = (one.schedule.commands[0].seconds for one in first.values())
    measurement = (DOCS / "measurement.md").read_text()
    assert f"0.3, 0.5, 0.8, 1.1 and 1.3 m/s for {quick:g} s each ({paper:g} s in `paper`)" in measurement
    assert "Two are walked by the mean action, six with noise of 0.3 σ" in measurement
    worth = rewards.resolve_weights({})["track_velocity"]
    assert worth == 2.0 and "half of perfect speed tracking (weight 2)" in training
    assert "half as much as perfect speed tracking (weight 2," in (DOCS / "power.md").read_text()


def test_following_a_run_tells_each_stage_by_its_line_and_its_file():
    source = (REPOSITORY / "hts/run/algorithm.py").read_text()
    page = (DOCS / "following-a-run.md").read_text()
    (table,) = re.findall(r"^\| line on the terminal .*\n.*\n((?:\|.*\n)+)", page, re.MULTILINE)
    rows = [re.split(r" \| ", row.strip("| ")) for row in table.splitlines()]
    stages = set(re.findall(r'job\.do\(\s*f?"(?:\{name\}/)?(\w+)"', source))
    assert {"collect", "fit", "nearer", "final"} <= stages
    assert {name for row in rows for name in re.findall(r"(\w+)\.json", row[1])} - {"segments"} == stages
    said = re.sub(r"\{(?:job\.)?config\.world\.name\}", "twin", source)
    assert [line for line, _, _ in rows if re.sub(r" \(.*", "", line) not in said] == []


def test_every_page_is_in_the_index():
    listed = set(LINK.findall((DOCS / "index.md").read_text()))
    assert {page.name for page in DOCS.glob("*.md")} - {"index.md"} == listed


def test_every_page_for_authors_is_in_their_index_and_in_the_sites_navigation():
    there = {f"authors/{page.name}" for page in DOCS.glob("authors/*.md")}
    assert there <= set(LINK.findall((DOCS / "plugins.md").read_text()))
    assert there <= set(re.findall(r"authors/[a-z-]+\.md", (REPOSITORY / "mkdocs.yml").read_text()))


@pytest.mark.slow
def test_the_site_is_built_without_a_warning(tmp_path):
    """A link, an anchor or a name of the API reference that leads nowhere is a warning, and stops the build."""
    done = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", str(tmp_path / "site")],
        cwd=REPOSITORY,
        env={**os.environ, "NO_MKDOCS_2_WARNING": "1"},
        capture_output=True,
        text=True,
        timeout=1000,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    reference = (tmp_path / "site/authors/api.html").read_text()
    for name in ("hts.contracts.Objective.reward", "hts.hookspecs.hts_worlds", "hts.envs.folded.FoldedEnv"):
        assert f'id="{name}"' in reference, name


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_command_that_a_page_names_exists(page):
    named = set(re.findall(r"(?:`|\n\s+|bin/)hts ([a-z][a-z-]*)", page.read_text()))
    assert named - set(COMMANDS) - set(load().commands) == set()


def test_the_objective_of_the_manual_loads_and_compares(install):
    text = (REPOSITORY / "docs/plugins.md").read_text()
    (code,) = re.findall(r"```python[^\n]*\n(.*?)```", text, re.DOTALL)
    install("hts-heat", {"hts_heat": code}, {"heat": "hts_heat"})
    registry = load()
    assert registry.objectives["heat"].package == "hts-heat"
    objective = registry.make_objective("heat")
    assert (objective.measurement_model().name, objective.target.name) == ("lstm", "motor_heat")
    compared = objective.compare({"heat": 30.0}, {"heat": 40.0})
    assert (compared.improvement, compared.selection_score) == (10.0, 10.0)
