"""How the layers of a configuration lie on each other: order of writing does not matter, names decide what is kept."""

from __future__ import annotations

import itertools

import pytest

from hts.config_loading import load_config
from hts.errors import ConfigError
from hts.layers import in_full, laid
from hts.overrides import Override, nested


def selector(file=None, *overrides):
    config = load_config(objectives=["fake"], robot="hopper", file=file, overrides=overrides)
    return config.selection.selector.name, config.selection.selector.settings


def test_settings_of_a_selector_stay_whatever_the_order_of_set():
    sets = ("selection.selector.least=0.3", "selection.selector.name=knee", "selection.selector.most=2")
    for order in itertools.permutations(sets):
        assert selector(None, *order) == ("knee", {"least": 0.3, "most": 2})


def test_settings_in_a_file_without_a_name_go_to_the_selector_that_set_names(tmp_path):
    file = tmp_path / "mine.yaml"
    file.write_text("selection: {selector: {least: 0.3}}\n")
    assert selector(file, "selection.selector.name=knee") == ("knee", {"least": 0.3})
    assert selector(file, "selection.selector=knee") == ("knee", {"least": 0.3})


def test_settings_that_were_written_for_another_plugin_are_dropped(tmp_path):
    file = tmp_path / "mine.yaml"
    file.write_text("selection: {selector: {name: racing, rounds: 3}}\n")
    assert selector(file) == ("racing", {"rounds": 3})
    assert selector(file, "selection.selector=knee") == ("knee", {})


def test_a_name_alone_stands_for_a_mapping_with_that_name():
    written = in_full({"robot": "dog", "world": "yard", "selection": {"selector": "knee"}}, "file")
    assert written == {"robot": {"name": "dog"}, "world": {"name": "yard"}, "selection": {"selector": {"name": "knee"}}}


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ("heat", {"heat": {}}),
        (["heat", "noise"], {"heat": {}, "noise": {}}),
        (["heat", {"noise": {"gain": 2}}], {"heat": {}, "noise": {"gain": 2}}),
        ({"heat": None, "noise": {"gain": 2}}, {"heat": {}, "noise": {"gain": 2}}),
        (None, {}),
    ],
)
def test_objectives_may_be_a_name_a_list_or_a_mapping(given, expected):
    assert in_full({"objectives": given}, "file") == {"objectives": expected}


@pytest.mark.parametrize(
    ("layer", "message"),
    [
        ({"objectives": ["heat", "heat"]}, "'heat' stands there twice"),
        ({"objectives": 3}, "expected names, or names and their settings, found 3"),
        ({"objectives": [3]}, "expected a name, found 3"),
        ({"robot": ["dog"]}, "robot: expected a name, or a name and its settings, found ['dog']"),
        ({"selection": {"selector": 3}}, "selection.selector: expected a name"),
    ],
)
def test_what_is_no_name_is_refused(layer, message):
    with pytest.raises(ConfigError) as caught:
        in_full(layer, "mine.yaml")
    assert str(caught.value).startswith("mine.yaml: ") and message in str(caught.value)


def test_a_value_replaces_a_mapping_and_a_mapping_a_value():
    assert laid({"a": {"b": 1}}, {"a": 2}) == {"a": 2}
    assert laid({"a": {"b": 1}}, {"a": 2}, {"a": {"c": 3}}) == {"a": {"c": 3}}


def test_the_last_value_of_one_key_counts():
    assert nested([Override.parse("a.b=1"), Override.parse("a.b=2")]) == {"a": {"b": 2}}


def test_a_section_and_a_key_in_it_go_together_in_either_order():
    whole, key = Override.parse("a={b: 1, c: 1}"), Override.parse("a.b=2")
    assert nested([whole, key]) == nested([key, whole]) == {"a": {"b": 2, "c": 1}}


def test_a_key_inside_what_another_one_made_a_value_is_refused():
    with pytest.raises(ConfigError, match="--set a.b=2: 'a' is a value, it has no keys inside"):
        nested([Override.parse("a.b=2"), Override.parse("a=1")])
