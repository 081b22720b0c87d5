"""The `hts` command group: lists commands without importing them, imports one when it is called."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from typing import Any

import typer
from typer.core import TyperGroup
from typer.main import get_command

from hts import plugins
from hts.cli.commands import COMMANDS
from hts.errors import ConfigError, PluginError, unknown_name
from hts.plugins import Entry

SUMMARY = "Improve robot policies on what simulators cannot compute: measure, model, fine-tune, test, repeat."


class LazyGroup(TyperGroup):
    """Commands of the core from a table, commands of plugins from the registry; neither imported before use."""

    def list_commands(self, ctx: Any) -> list[str]:
        return [*COMMANDS, *sorted(_plugin_commands())]

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        if cmd_name in COMMANDS:
            return _built(cmd_name, importlib.import_module(COMMANDS[cmd_name][0]))
        plugin_commands = _plugin_commands()
        if cmd_name in plugin_commands:
            return _from_function(cmd_name, plugin_commands[cmd_name].factory())
        raise ConfigError(unknown_name("command", cmd_name, [*COMMANDS, *plugin_commands]))

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


def _from_function(name: str, function: Callable[..., Any]) -> Any:
    app = typer.Typer(add_completion=False, rich_markup_mode=None, pretty_exceptions_enable=False)
    app.command(name)(function)
    return get_command(app)
