"""The conformance kit: does what a package offers keep its side of the contracts? Behind `hts check PACKAGE`.

Each check is a function that returns nothing if all is well and raises otherwise; its docstring is the demand.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

from hts.errors import ConfigError, PluginError, unknown_name
from hts.plugins import KINDS, Entry, Registry
from hts.testing.conformance_checks import CHECKS

SETTING_NOBODY_HAS = "no_such_setting_of_anything"


@dataclass(frozen=True)
class Finding:
    """What was checked of what; fault: None if it is kept, else one line."""

    subject: str
    demand: str
    fault: str | None


def check_package(registry: Registry, package: str) -> list[Finding]:
    """Check everything that a distribution offers. Raises ConfigError if nothing of that name is installed."""
    for broken in registry.broken:
        if broken.package == package:
            return [Finding(f"entry point {broken.entry_point}", "It can be loaded.", broken.reason)]
    plugins = [plugin for plugin in registry.plugins if plugin.package == package]
    if not plugins:
        known = {p.package for p in registry.plugins} | {b.package for b in registry.broken}
        raise ConfigError(unknown_name("plugin package", package, known))
    findings = [_tried(f"module {plugin.module}", _imports_nothing_heavy, plugin.module) for plugin in plugins]
    for kind, word in KINDS.items():
        for entry in getattr(registry, kind).values():
            if entry.package == package:
                findings += _checked(f"{word} '{entry.name}'", kind, entry, registry)
    return findings


def _checked(subject: str, kind: str, entry: Entry, registry: Registry) -> Iterator[Finding]:
    for check in CHECKS[kind]:
        yield _tried(subject, check, entry, registry)
    if kind in ("objectives", "robots", "selectors"):  # made from settings alone
        yield _tried(subject, _refuses_unknown_settings, entry)


def _tried(subject: str, check: Callable[..., None], *given: Any) -> Finding:
    demand = " ".join((check.__doc__ or check.__name__).split())
    try:
        check(*given)
    except Exception as error:  # noqa: BLE001 - whatever a stranger's code does is a finding, not the end of the check
        text = " ".join(str(error).split())
        known = isinstance(error, (AssertionError, PluginError)) and text
        return Finding(subject, demand, text if known else f"{type(error).__name__}: {text}")
    return Finding(subject, demand, None)


def _imports_nothing_heavy(module: str) -> None:
    """Importing it imports neither torch nor mujoco."""
    code = f"import sys, {module}; print(*[n for n in ('torch', 'mujoco') if n in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise PluginError(done.stderr.strip().splitlines()[-1])
    if done.stdout.strip():
        raise PluginError(f"imports {done.stdout.strip()}: move the import into the function that needs it")


def _refuses_unknown_settings(entry: Entry) -> None:
    """A setting that it does not have is refused."""
    try:
        entry.factory({SETTING_NOBODY_HAS: 1})
    except Exception as error:
        if SETTING_NOBODY_HAS not in str(error):
            raise PluginError(f"refuses it without naming it: {type(error).__name__}: {error}") from error
        return
    raise PluginError("takes any setting, so a misspelt one goes unseen: use a model with extra='forbid'")
