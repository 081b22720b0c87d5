"""What help and version show, and that showing them imports nothing heavy."""

from __future__ import annotations

import importlib
import subprocess
import sys

import pytest
import typer

from hts.cli.commands import COMMANDS
from hts.cli.main import main


def test_help_lists_every_command_and_imports_none_of_them():
    code = (
        "import sys\nfrom hts.cli.main import main\nmain(['--help'])\n"
        "heavy = [n for n in ('torch', 'mujoco', 'numpy', 'rich', 'pydantic') if n in sys.modules]\n"
        "print(heavy, [n for n in sys.modules if n.startswith('hts.cli.')], file=sys.stderr)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    for name, (module, line) in COMMANDS.items():
        assert f"  {name} " in done.stdout
        assert line[:40] in done.stdout
        assert f"'{module}'" not in done.stderr
    assert done.stderr.startswith("[] ")


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_has_help_and_imports_nothing_heavy(name):
    code = f"import sys\nfrom hts.cli.main import main\nmain([{name!r}, '--help'])\nassert 'torch' not in sys.modules"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith(f"Usage: hts {name}")


def test_no_arguments_show_the_help(capsys):
    assert main([]) == 0
    assert capsys.readouterr().out.startswith("Usage: hts")


def test_the_version_is_shown(capsys):
    assert main(["--version"]) == 0
    assert capsys.readouterr().out.startswith("hts 0.")


def test_the_help_lists_the_option_that_shows_the_version(capsys):
    assert main(["--help"]) == 0
    assert "--version  Show the version and exit." in capsys.readouterr().out
    assert main(["--version", "run"]) == 0  # as other programs do: what follows is not looked at
    assert capsys.readouterr().out.startswith("hts 0.")


def test_python_m_hts_is_hts():
    done = subprocess.run([sys.executable, "-m", "hts", "--version"], capture_output=True, text=True, check=True)
    assert done.stdout.startswith("hts 0.")


def test_the_table_of_commands_and_the_modules_agree():
    for name, (module, _) in COMMANDS.items():
        loaded = importlib.import_module(module)
        assert isinstance(getattr(loaded, "app", None), typer.Typer) or loaded.command.__doc__, name
