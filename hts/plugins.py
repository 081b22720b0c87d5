"""The registry: everything that comes in by a hook, with the package it came from.

Entry points of the group ``hts`` are loaded one by one. A plugin that cannot be loaded is kept in
`Registry.broken` with its reason, so that `hts plugins` can show it; the others go on. The core's own
worlds, selector and log reader come in by the same door, as the entry point ``core``.
"""

from __future__ import annotations

import contextlib
import importlib.metadata
import inspect
import sys
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

import pluggy

from hts import hookspecs
from hts.errors import ConfigError, HtsError, PluginError, unknown_name

if TYPE_CHECKING:
    from hts.contracts import (
        Instrument,
        LogReader,
        MeasurementModel,
        ModelContext,
        Objective,
        Robot,
        Selector,
        Settings,
        World,
        WorldContext,
    )

GROUP = "hts"

KINDS: dict[str, str] = {
    "objectives": "objective",
    "measurement_models": "measurement model",
    "robots": "robot",
    "worlds": "world",
    "instruments": "instrument",
    "selectors": "selector",
    "log_readers": "log reader",
    "commands": "command",
}
"""Field of the registry (and end of the hook's name) -> how a person calls one of them."""


@dataclass(frozen=True)
class Entry:
    """One thing that a plugin offers: its name, what makes it, the distribution it came from, and, of an objective,
    the settings of its own that it has in a preset, by the preset's name."""

    name: str
    factory: Callable[..., Any]
    package: str
    presets: Mapping[str, Mapping[str, Any]] = field(default_factory=dict, compare=False)


@dataclass(frozen=True)
class Plugin:
    """An entry point that was loaded: its name, the module behind it, its distribution and version, and how long that
    took, which every command waits for."""

    entry_point: str
    module: str
    package: str
    version: str
    seconds: float = 0.0


@dataclass(frozen=True)
class Broken:
    """An entry point that could not be loaded, and why."""

    entry_point: str
    package: str
    reason: str


@dataclass(frozen=True)
class Registry:
    """Everything that is installed, by kind and name. Mappings name -> Entry."""

    robots: Mapping[str, Entry] = field(default_factory=dict)
    objectives: Mapping[str, Entry] = field(default_factory=dict)
    measurement_models: Mapping[str, Entry] = field(default_factory=dict)
    worlds: Mapping[str, Entry] = field(default_factory=dict)
    instruments: Mapping[str, Entry] = field(default_factory=dict)
    selectors: Mapping[str, Entry] = field(default_factory=dict)
    log_readers: Mapping[str, Entry] = field(default_factory=dict)
    commands: Mapping[str, Entry] = field(default_factory=dict)
    plugins: tuple[Plugin, ...] = ()
    broken: tuple[Broken, ...] = ()

    def make_robot(self, name: str, settings: Settings | None = None) -> Robot:
        return self._make("robots", name, dict(settings or {}))

    def make_objective(self, name: str, settings: Settings | None = None) -> Objective:
        """settings: what stands under `objectives.NAME`; the choice of a measurement model in it is not the
        objective's."""
        from hts.contracts import own_settings

        return self._make("objectives", name, own_settings(settings or {}))

    def make_measurement_model(self, name: str, settings: Settings | None, context: ModelContext) -> MeasurementModel:
        """A fresh, unfitted model; its factory also gets this registry, for models that are made of others."""
        from hts.factories import check_settings_kept

        model = self._make("measurement_models", name, dict(settings or {}), replace(context, registry=self))
        model.name = name
        package = self.entry("measurement_models", name).package
        check_settings_kept(model, settings or {}, f"measurement model '{name}'", package)
        return model

    def make_world(self, name: str, settings: Settings | None, context: WorldContext) -> World:
        return self._make("worlds", name, dict(settings or {}), context)

    def make_instrument(self, name: str, settings: Settings | None, robot: Robot) -> Instrument:
        return self._make("instruments", name, dict(settings or {}), robot)

    def make_selector(self, name: str, settings: Settings | None = None) -> Selector:
        return self._make("selectors", name, dict(settings or {}))

    def make_log_reader(self, name: str, settings: Settings | None = None) -> LogReader:
        return self._make("log_readers", name, dict(settings or {}))

    def offered(self, kind: str) -> Mapping[str, Entry]:
        """Everything of one kind by name; kind is one of KINDS."""
        return vars(self)[kind]

    def not_loaded(self) -> str:
        """What to add to a line about a name that nobody knows, where a package could not be loaded; else empty."""
        packages = ", ".join(sorted({broken.package for broken in self.broken}))
        return f" Could not be loaded: {packages}; `hts plugins` says why." if packages else ""

    def entry(self, kind: str, name: str) -> Entry:
        """The entry of that name; kind is one of KINDS. Raises ConfigError with the closest name."""
        entries = self.offered(kind)
        if name not in entries:
            message = unknown_name(KINDS[kind], name, entries) + self.not_loaded()
            if not entries and not self.broken:
                message += " Install the package that brings it; `hts plugins` lists what is there."
            raise ConfigError(message)
        return entries[name]

    def _make(self, kind: str, name: str, settings: dict[str, Any], *context: Any) -> Any:
        """Call the factory; whatever goes wrong in it is one line, see `hts.factories.made_by`."""
        from hts.factories import made_by

        entry = self.entry(kind, name)
        return made_by(entry.factory, kind, f"{KINDS[kind]} '{name}'", name, entry.package, settings, *context)


def load(entry_points: Iterable[importlib.metadata.EntryPoint] | None = None) -> Registry:
    """Load all plugins that are installed (or only those given) into a registry.

    Raises PluginError if two plugins offer one name. Anything else that is wrong with a plugin
    (it cannot be imported, was written for other hooks, misspells a hook, raises in one) lands in
    `Registry.broken` and none of what it offers is kept.
    """
    found: dict[str, dict[str, Entry]] = {kind: {} for kind in KINDS}
    plugins: list[Plugin] = []
    broken: list[Broken] = []
    if entry_points is None:
        entry_points = importlib.metadata.entry_points(group=GROUP)
    for point in sorted(entry_points, key=lambda point: (_package(point), point.name)):
        package, begun = _package(point), time.monotonic()
        try:
            offered = _offers(point, package)
        except (Exception, SystemExit) as error:  # noqa: BLE001 - any fault of a stranger's module is shown, never fatal to others
            broken.append(Broken(point.name, package, _reason(error)))
            continue
        for kind, entry in offered:
            other = found[kind].get(entry.name)
            if other is not None:
                raise PluginError(_two_of_one_name(kind, other, entry))
            found[kind][entry.name] = entry
        version = point.dist.version if point.dist is not None else "unknown"
        plugins.append(Plugin(point.name, point.value, package, version, time.monotonic() - begun))
    return Registry(**found, plugins=tuple(plugins), broken=tuple(broken))


def _offers(point: importlib.metadata.EntryPoint, package: str) -> list[tuple[str, Entry]]:
    """Import one plugin and ask it for all it offers, as (kind, entry)."""
    with contextlib.redirect_stdout(sys.stderr):  # what hts prints may be read by a program
        module = point.load()
    if not isinstance(module, ModuleType):
        raise PluginError(
            f"names '{point.attr}' in {point.module}, expected the module alone, whose hooks are asked: "
            f'{point.name} = "{point.module}" in pyproject.toml, then install the package again'
        )
    written_for = vars(module).get("HTS_API")
    if written_for is None:
        raise PluginError(
            f"{point.value} does not say which version of the hooks it was written for; "
            f"add the line HTS_API = {hookspecs.API_VERSION} to it"
        )
    if not isinstance(written_for, int) or isinstance(written_for, bool):
        raise PluginError(
            f"{_line_of_version(module)}: HTS_API is {written_for!r}, expected a whole number; "
            f"write HTS_API = {hookspecs.API_VERSION}"
        )
    if written_for != hookspecs.API_VERSION:
        raise PluginError(_other_version(module, package, written_for))
    manager = pluggy.PluginManager(GROUP)  # one each, so that what it registers can be told apart from the others'
    manager.add_hookspecs(hookspecs)
    _check_hooks(manager, module)
    manager.register(module, name=point.name)
    manager.check_pending()  # pluggy accepts a misspelt hook without a word
    offered: list[tuple[str, Entry]] = []
    for kind in KINDS:

        def register(
            name: str,
            factory: Callable[..., Any] | None = None,
            presets: Mapping[str, Mapping[str, Any]] | None = None,
            kind: str = kind,
        ) -> None:
            if not isinstance(name, str) or not name or factory is None or not callable(factory):
                raise PluginError(f"hts_{kind}: register({name!r}, {factory!r}) needs a name and something to call")
            offered.append((kind, Entry(name, factory, package, presets or {})))

        getattr(manager.hook, f"hts_{kind}")(register=register)
    return offered


def _check_hooks(manager: pluggy.PluginManager, module: ModuleType) -> None:
    """Raise PluginError for a hook that is not marked as one, which pluggy passes by without a word, and for a marked
    function whose name is that of no hook."""
    hooks = [f"hts_{kind}" for kind in KINDS]
    for name, value in vars(module).items():
        if not inspect.isroutine(value):
            continue
        marks = manager.parse_hookimpl_opts(module, name)
        if marks is None and name in hooks:
            raise PluginError(
                f"{module.__name__}: {name}() is not marked as a hook, so nobody asks it; write @hookimpl above it "
                "(from hts import hookimpl)"
            )
        if marks is not None and not marks["optionalhook"] and (marks["specname"] or name) not in hooks:
            raise PluginError(f"{module.__name__}: {name}(): " + unknown_name("hook", marks["specname"] or name, hooks))
        if marks is not None and (marks["specname"] or name) in hooks:
            asked = [one.name for one in inspect.signature(value).parameters.values() if one.default is one.empty]
            if asked != ["register"]:
                raise PluginError(
                    f"{module.__name__}: {name}({', '.join(asked)}) cannot be asked: write def {name}(register)"
                )


def _other_version(module: ModuleType, package: str, written_for: int) -> str:
    """What whoever wrote the plugin has to do, or else whoever installed it."""
    said = (
        f"{package} was written for version {written_for} of the hooks, this hts has version {hookspecs.API_VERSION}; "
    )
    change = hookspecs.CHANGES.get(written_for)
    if change is None:
        return said + f"install a version of {package} made for this hts"
    return (
        said
        + f"since then {change}. Mend that, then change {_line_of_version(module)} to HTS_API = {hookspecs.API_VERSION}"
    )


def _line_of_version(module: ModuleType) -> str:
    """ "line 7 of …/plugin.py", where the module says its version."""
    try:
        file = Path(module.__file__ or "")
        lines = file.read_text(encoding="utf-8").splitlines()
        number = next(index for index, line in enumerate(lines, start=1) if line.startswith("HTS_API"))
    except (OSError, UnicodeDecodeError, StopIteration):
        return f"HTS_API of {module.__name__}"
    return f"line {number} of {file}"


def _package(point: importlib.metadata.EntryPoint) -> str:
    return point.dist.name if point.dist is not None else point.value


def _two_of_one_name(kind: str, first: Entry, second: Entry) -> str:
    if first.package == second.package:
        return f"{first.package} offers two {KINDS[kind]}s named '{first.name}': rename one of them."
    return (
        f"Two {KINDS[kind]}s are named '{first.name}': one from {first.package}, one from {second.package}. "
        f"Uninstall one of the packages: pip uninstall {second.package}"
    )


def _reason(error: BaseException) -> str:
    """Why a plugin could not be loaded, on one line."""
    text = " ".join(str(error).split())
    if isinstance(error, HtsError):
        return text
    return f"{type(error).__name__}: {text}" if text else type(error).__name__
