"""Log readers and commands."""

from __future__ import annotations

import copy
import tempfile
from pathlib import Path

from hts.contracts import LogReader
from hts.plugins import Entry, Registry
from hts.testing.checks.ensure import ensure, refused
from hts.testing.examples.robot.robot import Tiny


def refuses_bad_logs(entry: Entry, registry: Registry) -> None:
    """Made without settings; a missing or garbage log is an error of hts.errors, one line, naming the file."""
    reader = entry.factory({})
    ensure(isinstance(reader, LogReader), f"is a {type(reader).__name__}, not a hts.contracts.LogReader")
    with tempfile.TemporaryDirectory() as folder:
        garbage = Path(folder) / "garbage.log"
        garbage.write_bytes(bytes(range(256)) * 8)
        for file in (Path(folder) / "missing.log", garbage):
            mapping: dict = {"channels": {}, "recording": {}}
            before = copy.deepcopy(mapping)
            with refused(file.name, f"makes a recording of {file.name}"):
                reader.read([file], mapping, Tiny())
            ensure(mapping == before, "changes the mapping that it is given in place")


def command_can_be_called(entry: Entry, registry: Registry) -> None:
    """Its factory gives a function whose arguments typer understands, and has a first line for `hts --help`."""
    import typer
    from typer.main import get_command

    function = entry.factory()
    ensure(callable(function), f"its factory gives a {type(function).__name__}, not a function")
    ensure(bool((entry.factory.__doc__ or "").strip()), "its factory has no docstring")
    app = typer.Typer(add_completion=False, rich_markup_mode=None)
    app.command(entry.name)(function)
    get_command(app)


LOG_READER_CHECKS = (refuses_bad_logs,)
COMMAND_CHECKS = (command_can_be_called,)
