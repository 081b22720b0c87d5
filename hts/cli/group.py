"""The `hts` command group: lists commands without importing them, imports one when it is called."""

from __future__ import annotations

import functools
import importlib
from collections.abc import Callable
from typing import Any

import typer
from typer.core import TyperGroup
from typer.main import get_command

from hts import plugins
from hts.cli.commands import COMMANDS
from hts.cli.one_line import one_line
from hts.cli.values import Command
from hts.errors import ConfigError, PluginError, unknown_name
from hts.guarded import guarded
from hts.plugins import Entry

SUMMARY = "Improve robot policies on what simulators cannot compute: measure, model, fine-tune, test, repeat."
VERSION = ("--version", "Show the version and exit.")  # which `main` answers, in whatever folder it is asked


class LazyGroup(TyperGroup):
    """Commands of the core from a table, commands of plugins from the registry; neither imported before use."""

    def list_commands(self, ctx: Any) -> list[str]:
        return [*COMMANDS, *sorted(_plugin_commands())]

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        if cmd_name in COMMANDS:
            return _built(cmd_name, importlib.import_module(COMMANDS[cmd_name][0]))
        plugin_commands = _plugin_commands()
        if cmd_name in plugin_commands:
            return _of_plugin(cmd_name, plugin_commands[cmd_name])
        raise ConfigError(unknown_name("command", cmd_name, [*COMMANDS, *plugin_commands]))

    def format_options(self, ctx: Any, formatter: Any) -> None:
        own = [record for one in self.get_params(ctx) if (record := one.get_help_record(ctx)) is not None]
        with formatter.section("Options"):
            formatter.write_dl([VERSION, *own])
        self.format_commands(ctx, formatter)

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        rows = [(name, line) for name, (_, line) in COMMANDS.items()]
        fault = ""
        try:
            for name, entry in sorted(_plugin_commands().items()):
                first_line = (entry.factory.__doc__ or "").strip().partition("\n")[0]
                rows.append((name, f"{first_line} [{entry.package}]".strip()))
        except PluginError as error:  # help must work when two plugins quarrel; every other command stops
            fault = str(error)
        with formatter.section("Commands"):
            formatter.write_dl(rows)
        if fault:
            with formatter.section("Plugins"):
                formatter.write_text(fault)


def hts_group() -> LazyGroup:
    return LazyGroup(name="hts", help=SUMMARY, rich_markup_mode=None, no_args_is_help=True)


def _plugin_commands() -> dict[str, Entry]:
    return {name: entry for name, entry in plugins.load().commands.items() if name not in COMMANDS}


def _built(name: str, module: Any) -> Any:
    app = vars(module).get("app")
    if isinstance(app, typer.Typer):
        group = get_command(app)
        group.name = name
        return group
    return _from_function(name, module.command)


def _of_plugin(name: str, entry: Entry) -> Any:
    """A plugin's command. What goes wrong in its code, and is none of the errors that hts or typer explains, is a
    PluginError that names it, and so is a factory that gives no function."""
    who = f"Command '{name}' (from {entry.package})"
    function = guarded(f"{who}: its factory", entry.factory)
    if not callable(function):
        raise PluginError(f"{who}: its factory gives a {type(function).__name__}, expected a function.")

    @functools.wraps(function)
    def asked(*given: Any, **named: Any) -> Any:
        try:
            return function(*given, **named)
        except Exception as error:
            if isinstance(error, typer.Exit) or one_line(error) is not None:
                raise
            text = " ".join(str(error).split())
            raise PluginError(f"{who} failed, {type(error).__name__}: {text} (HTS_DEBUG=1 shows where).") from error

    return guarded(f"{who}: its arguments", lambda: _from_function(name, asked))


def _from_function(name: str, function: Callable[..., Any]) -> Any:
    app = typer.Typer(add_completion=False, rich_markup_mode=None)
    app.command(name, cls=Command)(function)
    return get_command(app)
