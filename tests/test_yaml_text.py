"""YAML as people write it: what is read, and the one line for what is not."""

from __future__ import annotations

import pytest

from hts.errors import ConfigError
from hts.overrides import Override
from hts.yaml_text import MAX_DEPTH, load_mapping_file, load_text


def refusal(text: str) -> str:
    with pytest.raises(ConfigError) as caught:
        load_text(text, "mine.yaml")
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_a_key_that_stands_twice_is_refused_with_both_lines():
    assert (
        refusal("a: 1\nb: 2\na: 3\n")
        == "mine.yaml:3: not YAML: the key 'a' was written before, in line 1; write it once."
    )
    assert "the key 'b'" in refusal("a: {b: 1, b: 1}")


def test_equal_keys_of_different_mappings_are_fine():
    assert load_text("a: {x: 1}\nb: {x: 2}\n", "here") == {"a": {"x": 1}, "b": {"x": 2}}


def test_a_merged_mapping_may_be_overridden():
    assert load_text("base: &b {x: 1}\nother: {<<: *b, x: 2}\n", "here")["other"] == {"x": 2}


@pytest.mark.parametrize("deep", ["[" * 20_000, "[" * 20_000 + "]" * 20_000, "a: " + "{a: " * 20_000, "- " * 20_000])
def test_twenty_thousand_levels_are_one_line(deep):
    assert refusal(deep).startswith("mine.yaml")


def test_more_levels_than_a_configuration_has_are_refused():
    assert f"more than {MAX_DEPTH} levels" in refusal("[" * 31 + "]" * 31)
    assert load_text("[" * 30 + "]" * 30, "here")


def test_what_is_too_deep_is_refused_before_it_is_read_to_its_end():
    assert f"more than {MAX_DEPTH} levels" in refusal("[" * 31 + " and then no YAML: }")
    assert "not YAML" in refusal("[" * 30 + " and then no YAML: }")


def test_a_value_that_holds_itself_is_refused():
    assert f"more than {MAX_DEPTH} levels" in refusal("a: &a [*a, *a]")


@pytest.mark.parametrize(
    "text", ["a: 2026-99-99", "a: b: c", "a: [1", "\t- x", "a: *b", "a: !!python/name:os.system", "\x00"]
)
def test_what_is_no_yaml_is_one_line(text):
    assert refusal(text).startswith("mine.yaml")


@pytest.mark.parametrize(("text", "found"), [("- a\n", "a list"), ("3\n", "3"), ("1: 2\n", "the key 1")])
def test_a_file_without_keys_and_values_is_refused(tmp_path, text, found):
    file = tmp_path / "mine.yaml"
    file.write_text(text)
    with pytest.raises(ConfigError, match=found):
        load_mapping_file(file)


def test_an_empty_file_is_an_empty_mapping(tmp_path):
    file = tmp_path / "mine.yaml"
    file.write_text("# nothing yet\n")
    assert load_mapping_file(file) == {}


def test_set_reads_its_value_by_the_same_rules():
    assert Override.parse("a.b=[1, .inf]").value == [1, float("inf")]
    with pytest.raises(ConfigError, match="--set a="):
        Override.parse("a=" + "[" * 20_000)
    with pytest.raises(ConfigError, match="the key 'b' was written before"):
        Override.parse("a={b: 1, b: 2}")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (
            "seed: 010",
            "mine.yaml:1: not YAML: 010 counts to the base 8 there and would be 8; write the number that is meant",
        ),
        ("a: 1\nseed: 1:30", "mine.yaml:2: not YAML: 1:30 counts to the base 60 there and would be 90"),
        (
            "seconds: 1:30.5",
            'would be 90.5; write the number that is meant without a 0 in front or a colon, or "1:30.5" for text',
        ),
        ("- -07", "would be -7"),
    ],
)
def test_numbers_that_yaml_counts_to_another_base_are_refused(text, said):
    assert said in refusal(text)


def test_plain_numbers_and_quoted_ones_are_read():
    given = load_text("[0, -1, 10, 0.5, 1.0e+6, 0x1f, '010', '1:30', .inf]", "here")
    assert given == [0, -1, 10, 0.5, 1e6, 31, "010", "1:30", float("inf")]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("t,a,b\n0,1,2\n", "found comma-separated text, 't,a,b'. It is a table, no mapping of the log: give the file"),
        ("t;a\n0;1\n", "found comma-separated text, 't;a'."),
        ("walk\n", "found text, 'walk'. Is it a mapping of the log?"),
        ("- 1\n", "found a list."),
        ("3.5\n", "found 3.5."),
    ],
)
def test_a_file_that_holds_no_keys_and_values_is_told_what_it_holds(tmp_path, text, said):
    file = tmp_path / "m.yaml"
    file.write_text(text)
    with pytest.raises(ConfigError) as caught:
        load_mapping_file(file, "mapping of the log")
    assert str(caught.value).startswith(f"{file}: expected keys and values (KEY: VALUE), {said}")
