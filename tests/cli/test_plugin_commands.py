"""A command of a plugin ends like one of hts: one line for what goes wrong, its own exit status otherwise."""

from __future__ import annotations

import pytest

from hts.cli.main import main

PLUGIN = """
import typer
from hts import hookimpl
from hts.errors import ConfigError

HTS_API = 2


@hookimpl
def hts_commands(register):
    register("tell", make_tell)


def make_tell():
    {factory}


def tell(count: int = 1) -> None:
    {body}
"""


@pytest.fixture
def tell(install, capsys):
    """tell(body, factory) -> exit status and what was said of it on standard error."""

    def tell(body: str = "print(count)", factory: str = "return tell", *arguments: str) -> tuple[int, str]:
        install("lab", {"lab": PLUGIN.format(body=body, factory=factory)}, {"lab": "lab"})
        status = main(["tell", *arguments])
        return status, capsys.readouterr().err

    return tell


@pytest.mark.parametrize(
    ("body", "factory", "said"),
    [
        ("1 / 0", "return tell", "Command 'tell' (from lab) failed, ZeroDivisionError: division by zero (HTS_DEBUG=1"),
        ("pass", "return tel", "Command 'tell' (from lab): its factory failed, NameError"),
        ("pass", "tell", "Command 'tell' (from lab): its factory gives a NoneType, expected a function."),
        ("raise ConfigError('no such robot')", "return tell", "error: no such robot"),
    ],
)
def test_what_goes_wrong_is_one_line_that_names_its_package(tell, body, factory, said):
    status, err = tell(body, factory)
    assert status == 2 and said in err and err.count("\n") == 1 and err.startswith("error: ")


def test_its_exit_status_is_its_own(tell):
    assert tell("raise typer.Exit(3)") == (3, "")


def test_its_arguments_are_typers(tell):
    status, err = tell("pass", "return tell", "--count", "many")
    assert status == 2 and "'--count'" in err


def test_its_traceback_is_shown_where_it_is_asked_for(tell, monkeypatch):
    monkeypatch.setenv("HTS_DEBUG", "1")
    with pytest.raises(Exception, match="division by zero"):
        tell("1 / 0")


def test_a_command_that_hts_has_itself_is_listed_as_broken(install, capsys):
    text = PLUGIN.format(body="pass", factory="return tell").replace('register("tell"', 'register("run"')
    install("lab", {"lab": text}, {"lab": "lab"})
    assert main(["plugins"]) == 0
    shown = capsys.readouterr().out
    assert "lab (command 'run'): hts has a command 'run' of its own" in shown.partition("\nbroken\n")[2]
