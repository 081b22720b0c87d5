"""The JSON schema of a config file takes what hts takes: nothing is required that a preset gives, plugins are in it."""

from __future__ import annotations

import jsonschema
import pytest
import yaml
from pydantic import Field

from hts.config import Config
from hts.config_loading import dump_config, load_config, with_plugin_defaults
from hts.config_schema import config_schema
from hts.plugin_settings import in_full, settings_model, settings_of
from hts.plugins import Entry, Registry, load
from hts.presets import PRESETS
from hts.testing.packages import kit_installed


@pytest.fixture(scope="module")
def schema() -> dict:
    with kit_installed():
        made = config_schema(load())
    jsonschema.Draft202012Validator.check_schema(made)
    return made


def faults(schema: dict, text: str) -> list[str]:
    return [error.message for error in jsonschema.Draft202012Validator(schema).iter_errors(yaml.safe_load(text))]


@pytest.mark.parametrize(
    "text",
    [
        "{}",
        "seed: 3",
        "objectives: fake",
        "objectives: [fake]",
        "objectives: {fake: }",
        "{robot: tiny, world: twin}",
        "world: {block_seconds: 3}",
        "world: {name: field, block_seconds: 3}",
        "selection: {selector: {name: racing, rounds: 3}}",
        "selection: {selector: {rounds: 3}, elites: 2}",
        "selection: {selector: pareto}",
        "collection: {repeats: 3}",
        "collection: {schedule: {commands: [{seconds: 3, vx: 0.5}]}}",
        "finetune: {ppo: {fuse: null}}",
    ],
)
def test_files_that_hts_takes_are_valid(schema, tmp_path, text):
    assert faults(schema, text) == []
    file = tmp_path / "mine.yaml"
    file.write_text(text)
    load_config(file=file, objectives=["fake"], robot="tiny")


@pytest.mark.parametrize(
    "text",
    [
        "sead: 3",
        "objectives: [fale]",
        "robot: tiyn",
        "world: {name: twin, block_second: 3}",
        "selection: {selector: {name: racing, round: 3}}",
        "collection: {schedule: {commands: [{seconds: 3}]}}",
        "finetune: {num_envs: many}",
    ],
)
def test_files_that_hts_refuses_are_not_valid(schema, text):
    assert faults(schema, text)


@pytest.mark.parametrize("preset", PRESETS)
def test_what_config_show_prints_is_valid_and_reads_back_to_the_same(schema, preset, tmp_path):
    with kit_installed():
        config = with_plugin_defaults(load_config(preset=preset, objectives=["fake"], robot="tiny"), load())
    text = dump_config(config)
    assert faults(schema, text) == []
    file = tmp_path / "shown.yaml"
    file.write_text(text)
    assert load_config(file=file) == config


def test_settings_of_plugins_are_written_out_and_nothing_else_changes():
    config = load_config(preset="smoke", objectives=["fake"], robot="tiny", overrides=["world.dynamics.machine=3"])
    with kit_installed():
        full = with_plugin_defaults(config, load())
    assert full.world.settings["block_seconds"] == PRESETS["smoke"]["world"]["block_seconds"]
    assert full.world.settings["dynamics"]["machine"] == 3
    assert "physics_dt" in full.world.settings["dynamics"] and "physics_dt" not in config.world.settings["dynamics"]
    assert full.finetune == config.finetune


class Inner(Config):
    gain: float = Field(2.0, description="of the inner one")


class Outer(Config):
    """Settings with others inside."""

    names: tuple[str, ...] = Field(("a",), description="some")
    inner: Inner = Field(default_factory=Inner)
    path: str = Field(description="must be given")


def offered(factory) -> Registry:
    return Registry(selectors={"one": Entry("one", factory, "lab")})


def test_the_settings_of_a_plugin_are_found_by_its_own_refusal():
    assert settings_model(offered(lambda settings: Outer(**settings)), "selectors", "one") is Outer
    assert settings_model(offered(lambda settings: Outer.model_validate(dict(settings))), "selectors", "one") is Outer


def test_settings_that_are_checked_in_another_way_stay_unknown():
    def refuses(settings):
        raise ValueError("no")

    for factory in (dict, lambda settings: object(), refuses):
        registry = offered(factory)
        assert settings_model(registry, "selectors", "one") is None
        assert in_full(registry, "selectors", "one", {"a": 1}) == {"a": 1}


def test_settings_inside_others_have_dotted_keys():
    rows = {one.key: (one.default, one.description, one.needed) for one in settings_of(Outer)}
    assert rows == {
        "names": (["a"], "some", False),
        "inner.gain": (2.0, "of the inner one", False),
        "path": (None, "must be given", True),
    }
