"""`hts plugins NAME`: a page of one plugin."""

from __future__ import annotations

import json

import pytest

from hts.cli.plugin_page import plugin_data, plugin_text
from hts.errors import ConfigError
from hts.plugins import load
from hts.testing.examples.robot.robot import Tiny
from hts.testing.packages import kit_installed


@pytest.fixture(autouse=True)
def _kit():
    with kit_installed():
        yield


def test_a_robots_page_lists_every_channel_with_its_unit_and_those_that_only_the_robot_gives():
    (page,) = plugin_data(load(), "tiny")
    assert {row["name"]: (row["unit"], tuple(row["shape"])) for row in page["channels"]} == {
        name: (channel.unit, channel.shape) for name, channel in Tiny().channels().items()
    }
    assert any("target of fake" in row["for"] for row in page["real_channels"])
    text = plugin_text([page])
    assert "joint_torque" in text and "N*m" in text
    assert "\nchannels of the robot alone, which installed objectives want measured\n" in text


def test_a_selectors_page_lists_its_settings_with_defaults_and_descriptions():
    (page,) = plugin_data(load(), "racing")
    rows = {row["key"]: row for row in page["settings"]}
    assert rows["rounds"]["default"] == 4 and "budget" in rows["rounds"]["description"]
    assert "--set selection.selector.KEY=VALUE" in plugin_text([page])


def test_settings_of_the_twin_are_dotted():
    (page,) = plugin_data(load(), "twin")
    assert "dynamics.trunk_mass_scale" in {row["key"] for row in page["settings"]}


def test_an_objectives_page_names_inputs_target_and_default_weights():
    (page,) = plugin_data(load(), "fake")
    assert page["facts"]["inputs"] and page["facts"]["λ"]


def test_an_objectives_page_says_where_its_weights_follow_the_data(monkeypatch):
    registry = load()
    (page,) = plugin_data(registry, "fake")
    assert not any("fitted model" in key for key in page["facts"])
    monkeypatch.setattr(type(registry.make_objective("fake")), "weights_for", lambda self, spread, recordings: (1.0,))
    (page,) = plugin_data(registry, "fake")
    assert any("fitted model" in key for key in page["facts"])


def test_no_line_of_a_page_is_wider_than_the_terminal(monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    for name in ("tiny", "fake", "racing", "twin", "field"):
        assert max(map(len, plugin_text(plugin_data(load(), name)).splitlines())) <= 80


def test_a_misspelt_name_is_answered_with_the_closest():
    with pytest.raises(ConfigError, match="No plugin named 'racign'. Did you mean 'racing'?"):
        plugin_data(load(), "racign")


def test_a_name_of_a_plugin_that_did_not_load_points_to_it(install):
    install("stranger", {"stranger": "import no_such_library"}, {"odd": "stranger"})
    with pytest.raises(ConfigError, match=r"No plugin named 'odd'.* Could not be loaded: stranger; `hts plugins` says"):
        plugin_data(load(), "odd")


def test_the_command_prints_it_as_text_and_as_json(hts):
    assert "settings, --set selection.selector.KEY=VALUE" in hts("plugins", "racing").stdout
    assert json.loads(hts("plugins", "racing", "--json").stdout)[0]["name"] == "racing"


def test_a_plugin_that_every_command_waits_for_is_named():
    from hts.cli.plugins import as_text
    from hts.plugins import Plugin, Registry

    quick, slow = Plugin("a", "a.plugin", "lab-a", "1.0", 0.1), Plugin("b", "b.plugin", "lab-b", "1.0", 6.04)
    assert as_text(Registry(plugins=(quick, slow))).startswith("slow\n  lab-b (b): takes 6.0 s to import, which every")
