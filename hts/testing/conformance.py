"""The conformance kit: does what a package offers keep its side of the contracts? Behind `hts check PACKAGE`."""

from __future__ import annotations

import importlib.metadata
import os
import subprocess
import sys
import tomllib
import traceback
import warnings
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from hts.errors import ConfigError, HtsError, PluginError, unknown_name
from hts.plugins import GROUP, KINDS, Entry, Plugin, Registry
from hts.testing.checks import CHECKS, NEEDED
from hts.testing.checks.ensure import NotTried
from hts.testing.packages import kit_installed

HEAVY = ("torch", "mujoco", "dm_control", "jax", "tensorflow")

LOAD_ALONE = """
import sys
from importlib.metadata import entry_points
from hts.plugins import GROUP, load
module, *heavy = sys.argv[1:]
registry = load(point for point in entry_points(group=GROUP) if point.value == module)
assert not registry.broken, registry.broken[0].reason
print(*[name for name in heavy if name in sys.modules])
"""
"""Program that loads one plugin and asks it for all it offers, in a process that has imported nothing else."""


@dataclass(frozen=True)
class Finding:
    """One demand on one thing that a package offers; fault: what was found instead, or None if it is kept; tried:
    False if it was not looked at, because an earlier demand that it needs is not kept."""

    package: str
    subject: str
    demand: str
    fault: str | None
    tried: bool = True

    def line(self) -> str:
        """All of it on one line."""
        if self.fault is None:
            return f"{self.package}: {self.subject}: {self.demand}"
        fault = self.fault.rstrip(".")
        return f"{self.package}: {self.subject}: {fault}{'' if fault.endswith('?') else '.'} Expected: {self.demand}"


def check_package(
    registry: Registry, package: str, reserved: Collection[str] = (), folder: str | None = None
) -> list[Finding]:
    """Check everything that a distribution offers; reserved: names of commands that plugins cannot have; folder: by
    which somebody named it, see `package_of`.

    Raises ConfigError if nothing of that name is installed.
    """
    broken = [one for one in registry.broken if one.package == package]
    plugins = [plugin for plugin in registry.plugins if plugin.package == package]
    if not broken and not plugins:
        if folder is not None:
            raise ConfigError(_not_there(package, folder))
        known = {p.package for p in registry.plugins} | {b.package for b in registry.broken}
        raise ConfigError(unknown_name("plugin package", package, known))
    with kit_installed():  # worlds look the kit's robot and objective up, also in processes of their own
        absent = (Finding(package, f"entry point '{b.entry_point}'", "It can be loaded.", b.reason) for b in broken)
        return [*absent, *_checked(registry, package, plugins, reserved)]


def package_of(text: str) -> str:
    """The distribution that is meant: itself, or the one whose folder (with a pyproject.toml) is given.

    Raises ConfigError for a folder that is not a package.
    """
    folder = Path(text)
    if not folder.is_dir():
        return text
    file = folder / "pyproject.toml"
    try:
        return str(tomllib.loads(file.read_text(encoding="utf-8"))["project"]["name"])
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError, KeyError) as error:
        raise ConfigError(
            f"{file}: expected a pyproject.toml with a project name in it ({type(error).__name__}: {error}). "
            "Give the folder of a package, or the name of an installed one."
        ) from error


def _not_there(package: str, folder: str) -> str:
    try:
        importlib.metadata.distribution(package)
    except importlib.metadata.PackageNotFoundError:
        return f"{folder}: package '{package}' is not installed: pip install -e {folder}"
    return (
        f"{folder}: package '{package}' is installed and has no entry point of the group '{GROUP}', so hts finds "
        f"nothing of it. Name its module under [project.entry-points.{GROUP}] in {Path(folder) / 'pyproject.toml'}, "
        f"then: pip install -e {folder}"
    )


def _checked(
    registry: Registry, package: str, plugins: Collection[Plugin], reserved: Collection[str]
) -> Iterator[Finding]:
    for plugin in plugins:
        yield _tried(package, f"module {plugin.module}", _imports_nothing_heavy, plugin.module)
        yield _tried(package, f"module {plugin.module}", _offers_something, registry, package)
    for kind, word in KINDS.items():
        for entry in registry.offered(kind).values():
            if entry.package == package:
                yield from _in_turn(package, f"{word} '{entry.name}'", CHECKS[kind], entry, registry)
                if kind == "commands":
                    yield _tried(package, f"{word} '{entry.name}'", _hides_no_command, entry, reserved)


def _in_turn(
    package: str, subject: str, checks: Sequence[Callable[..., None]], entry: Entry, registry: Registry
) -> Iterator[Finding]:
    """Each check of one thing; those after one that they need and that is not kept are not tried."""
    modules = [plugin.module for plugin in registry.plugins if plugin.package == package]
    possible = True
    for check in checks:
        if not possible:
            yield Finding(package, subject, _demand(check), None, tried=False)
            continue
        finding = _tried(package, subject, check, entry, registry, modules=modules)
        possible = finding.fault is None or check not in NEEDED
        yield finding


def _demand(check: Callable[..., None]) -> str:
    return " ".join((check.__doc__ or check.__name__).split())


def _tried(
    package: str, subject: str, check: Callable[..., None], *given: Any, modules: Collection[str] = ()
) -> Finding:
    """modules: of the package's plugins, in whose code the place of an exception is looked for."""
    demand = _demand(check)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of libraries; what matters is found by the checks
            check(*given)
    except NotTried:
        return Finding(package, subject, demand, None, tried=False)
    except (Exception, SystemExit) as error:  # noqa: BLE001 - whatever a stranger's code does is a finding, no end
        if os.environ.get("HTS_DEBUG") == "1":
            traceback.print_exception(error, file=sys.stderr)
        text = " ".join(str(error).split())
        known = isinstance(error, HtsError) and text
        fault = text if known else f"{type(error).__name__}: {text}"
        place = _place(error, modules)
        return Finding(package, subject, demand, f"{fault.rstrip('.')} (at {place})" if place else fault)
    return Finding(package, subject, demand, None)


def _place(error: BaseException, modules: Collection[str]) -> str | None:
    """FILE:LINE of the innermost line of the package's own code that an unforeseen exception went through, also of one
    that a check put into words; None for an error of hts.errors, and where the package has no part in it."""
    cause = error.__cause__ or error.__context__
    unforeseen = error if not isinstance(error, HtsError) else cause if isinstance(error, PluginError) else None
    if unforeseen is None or isinstance(unforeseen, HtsError | ValidationError):
        return None
    packages = {_own_package(module) for module in modules}
    found = None
    for frame, line in traceback.walk_tb(unforeseen.__traceback__):
        module = str(frame.f_globals.get("__name__", ""))
        if any(module == own or module.startswith(f"{own}.") for own in packages):
            found = f"{_shown(frame.f_code.co_filename)}:{line}"
    return found


def _own_package(module: str) -> str:
    """The Python package that a plugin's module lies in: `hts_heat` of `hts_heat.plugin`; it may be the module."""
    first = module.split(".")[0]
    return module.rpartition(".")[0] or module if first == "hts" else first


def _shown(file: str) -> str:
    """Seen from the current folder where it lies in it."""
    path = Path(file)
    return str(path.relative_to(Path.cwd())) if path.is_relative_to(Path.cwd()) else file


def _imports_nothing_heavy(module: str) -> None:
    """Loading it is quick: torch, mujoco and their like are imported where they are needed, inside functions."""
    done = subprocess.run(
        [sys.executable, "-P", "-c", LOAD_ALONE, module, *HEAVY], capture_output=True, text=True, check=False
    )
    if done.returncode != 0:
        raise PluginError(f"cannot be loaded alone: {(done.stderr.strip() or 'the process ended').splitlines()[-1]}")
    if done.stdout.strip():
        raise PluginError(f"imports {done.stdout.strip()} when it is loaded")


def _offers_something(registry: Registry, package: str) -> None:
    """It registers one thing at least; hooks carry `@hookimpl` and call `register`."""
    if not any(entry.package == package for kind in KINDS for entry in registry.offered(kind).values()):
        raise PluginError("registers nothing")


def _hides_no_command(entry: Entry, reserved: Collection[str]) -> None:
    """Its name is not that of a command that hts has already, which would win."""
    if entry.name in reserved:
        raise PluginError(f"'{entry.name}' is a command of hts")
