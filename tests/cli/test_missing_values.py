"""An option without its value does not take the next option for it."""

from __future__ import annotations

import pytest
import typer

from hts.cli.group import hts_group
from hts.cli.main import main


@pytest.mark.parametrize(
    ("words", "option", "found", "command"),
    [
        (["export", "DIR", "--measurement-model", "--to", "X"], "--measurement-model", "--to", "export"),
        (["run", "--objective", "--robot", "go1"], "--objective", "--robot", "run"),
        (["run", "--objective", "power", "--set", "--dry-run"], "--set", "--dry-run", "run"),
        (["data", "lag", "S", "--target", "--json"], "--target", "--json", "data lag"),
    ],
)
def test_the_option_that_lacks_a_value_is_named(words, option, found, command, capsys):
    assert main(words) == 2
    assert capsys.readouterr().err == (
        f"error: Invalid value for {option}: expected a value, found the option {found}. (`hts {command} --help`)\n"
    )


def test_a_value_that_looks_like_an_option_is_given_with_an_equals_sign(capsys):
    assert main(["export", "DIR", "--measurement-model=--to", "--to", "X.safetensors"]) != 0
    assert "expected a value" not in capsys.readouterr().err


def test_commands_of_groups_and_of_plugins_are_all_looked_at():
    context = typer.Context(hts_group())
    assert type(hts_group().get_command(context, "calibrate-twin")).__name__ == "Command"
