"""`hts plugins`: what is installed, and what could not be loaded."""

from __future__ import annotations

import json
from typing import Annotated, Any

import typer

from hts import plugins
from hts.cli import options
from hts.cli.commands import COMMANDS
from hts.errors import HtsError, PluginError
from hts.plugins import KINDS, Registry


def command(
    name: Annotated[
        str | None, typer.Argument(metavar="NAME", help="One of them: its settings, and a robot's channels.")
    ] = None,
    json_: options.AsJson = False,
) -> None:
    """List everything that plugins offer, by kind, with its package; broken plugins with the reason. Or all of one."""
    registry = plugins.load()
    if name is not None:
        from hts.cli.plugin_page import plugin_data, plugin_text

        pages = plugin_data(registry, name)
        typer.echo(json.dumps(pages, indent=2, default=str) if json_ else plugin_text(pages))
        return
    typer.echo(json.dumps(as_data(registry), indent=2) if json_ else as_text(registry))


def as_data(registry: Registry) -> dict[str, Any]:
    """{kind: [{"name", "package", "summary"}], "plugins": […], "broken": [{"entry_point", "package", "reason"}]}"""
    not_made = _not_made(registry)
    data: dict[str, Any] = {
        kind: [
            {"name": entry.name, "package": entry.package, "summary": _summary(entry.factory)}
            for _, entry in sorted(registry.offered(kind).items())
            if (kind, entry.name) not in not_made
        ]
        for kind in KINDS
    }
    data["plugins"] = [
        {"entry_point": p.entry_point, "module": p.module, "package": p.package, "version": p.version}
        for p in registry.plugins
    ]
    data["broken"] = [{"entry_point": b.entry_point, "package": b.package, "reason": b.reason} for b in registry.broken]
    data["broken"] += [
        {"entry_point": f"{KINDS[kind]} '{name}'", "package": registry.entry(kind, name).package, "reason": reason}
        for (kind, name), reason in not_made.items()
    ]
    return data


SLOW = 2.0
"""s, also on a busy machine: importing a plugin that imports nothing heavy takes a hundredth of it."""
MADE_QUICKLY = ("objectives", "robots", "selectors", "log_readers")
"""Kinds that are made of their settings alone, in milliseconds: what is broken behind a factory shows so."""


def _not_made(registry: Registry) -> dict[tuple[str, str], str]:
    """(kind, name) of what is registered and cannot be made, or never asked for -> why. One that only needs settings is
    not among them."""
    found: dict[tuple[str, str], str] = {
        ("commands", name): f"hts has a command '{name}' of its own, which is the one that runs. Give it another name."
        for name in sorted(set(registry.commands) & set(COMMANDS))
    }
    for kind in MADE_QUICKLY:
        make = getattr(registry, f"make_{kind.removesuffix('s')}")
        for name in sorted(registry.offered(kind)):
            try:
                make(name)
            except PluginError as error:
                found[kind, name] = str(error)
            except HtsError:  # such as a setting that has no default
                continue
    return found


def as_text(registry: Registry) -> str:
    data = as_data(registry)
    lines: list[str] = []
    for kind in KINDS:
        if data[kind]:
            lines.append(kind.replace("_", " "))
            width = max(len(row["name"]) for row in data[kind])
            packages = max(len(row["package"]) for row in data[kind])
            for row in data[kind]:
                lines.append(f"  {row['name']:<{width}}  {row['package']:<{packages}}  {row['summary']}".rstrip())
    slow = [one for one in registry.plugins if one.seconds > SLOW]
    if slow:
        lines.append("slow")
        lines += [
            f"  {one.package} ({one.entry_point}): takes {one.seconds:.1f} s to import, which every command waits for. "
            "Import what is heavy inside functions."
            for one in slow
        ]
    if data["broken"]:
        lines.append("broken")
        lines += [f"  {row['package']} ({row['entry_point']}): {row['reason']}" for row in data["broken"]]
    return "\n".join(lines)


def _summary(factory: Any) -> str:
    return (factory.__doc__ or "").strip().partition("\n")[0]
