"""Relative paths in settings become absolute before a run keeps them; names stay names."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml

from hts import plugins
from hts.config_base import Named
from hts.config_loading import dump_config, load_config, read_config
from hts.oracle import start_oracle
from hts.run import expected, start_run
from hts.whole_paths import with_whole_paths
from hts.worlds.twin.reality import locate


@pytest.fixture
def here(tmp_path, monkeypatch) -> Path:
    """The working folder; what lies there."""
    monkeypatch.chdir(tmp_path)
    for name in ("mine.json", "dev-03", "mapping.yaml", "walk.safetensors"):
        (tmp_path / name).write_text("{}")
    return tmp_path.resolve()


def configured(world: dict | None = None, robot: dict | None = None):
    made = load_config(objectives=["power"], robot="go1", preset="smoke", engine="mujoco")
    return made.model_copy(
        update={"world": Named(**(world or {"name": "twin"})), "robot": Named(name="go1", **(robot or {}))}
    )


@pytest.mark.parametrize(
    ("world", "key", "expected"),
    [
        ({"name": "twin", "reality": "mine.json"}, "reality", "mine.json"),
        ({"name": "twin", "reality": "./mine.json"}, "reality", "mine.json"),
        ({"name": "field", "mapping": "mapping.yaml"}, "mapping", "mapping.yaml"),
    ],
)
def test_a_relative_path_in_a_worlds_settings_becomes_absolute(here, world, key, expected):
    config = configured({**world, "block_seconds": 5})
    found = with_whole_paths(config, plugins.load())
    assert found.world.settings == {key: str(here / expected), "block_seconds": 5}
    assert found.model_copy(update={"world": config.world}) == config


def test_a_relative_path_in_a_robots_settings_becomes_absolute(here):
    found = with_whole_paths(configured(robot={"policy": "walk.safetensors"}), plugins.load())
    assert found.robot.settings == {"policy": str(here / "walk.safetensors")}


@pytest.mark.parametrize(
    "world",
    [
        {"name": "twin"},
        {"name": "twin", "reality": "dev-03"},  # a name, also where a file is called so
        {"name": "twin", "reality": "elsewhere.json"},  # is not here
        {"name": "field", "mapping": "/nowhere/mapping.yaml"},
    ],
)
def test_names_and_what_is_not_here_stay_as_they_are_written(here, world):
    config = configured(world)
    assert dump_config(with_whole_paths(config, plugins.load())) == dump_config(config)


def begun(monkeypatch, start, config, out: Path) -> dict:
    """config.yaml of a run that stops right after it."""
    for place in ("hts.run.resume_run", "hts.oracle.resume_oracle", "hts.run.ready.check_ready"):
        monkeypatch.setattr(place, lambda *given: None)
    start(config, out, registry=plugins.load())
    return yaml.safe_load((out / "config.yaml").read_text())


def test_a_run_keeps_the_whole_path_of_a_reality(here, monkeypatch):
    kept = begun(monkeypatch, start_run, configured({"name": "twin", "reality": "mine.json"}), here / "run")
    assert kept["world"] == {"name": "twin", "reality": str(here / "mine.json")}


def test_an_oracle_keeps_the_whole_path_of_a_reality(here, monkeypatch):
    (here / "mine.json").write_bytes(locate("dev-03").read_bytes())
    config = load_config(
        objectives=["power"], robot="go1", preset="smoke", oracle=True, overrides=["world.reality=mine.json"]
    )
    kept = begun(monkeypatch, start_oracle, config, here / "oracle")
    assert kept["world"]["reality"] == str(here / "mine.json")


@pytest.mark.parametrize("whole", [True, False], ids=["whole", "of a run of before"])
def test_a_run_that_was_begun_with_a_relative_path_is_the_one_that_is_asked_for_again(here, whole):
    config = configured(robot={"policy": "walk.safetensors"})
    kept = with_whole_paths(config, plugins.load()) if whole else config
    (here / "run").mkdir()
    (here / "run/config.yaml").write_text(dump_config(kept))
    assert read_config(here / "run/config.yaml") == kept
    expected._check_same(here / "run", config)
