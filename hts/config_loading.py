"""From preset, config file, options and --set to one frozen RunConfig; and from a saved config back to it.

Later wins: preset < what several objectives change of it (`presets.SEVERAL`) < set-points of a robot with another task
than to follow a velocity (`hts.task_settings`) < --config FILE < --objective, --robot,
--world, --engine, --executor, --seed < --set KEY=VALUE. How one layer is laid on another: `hts.layers`.
"""

from __future__ import annotations

import tempfile
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import yaml
from pydantic import ValidationError

from hts.checked_selector import checked_selector
from hts.config import Config, Named, RunConfig
from hts.contracts import MODEL, chosen_model, own_settings
from hts.engines import check_engine
from hts.errors import ConfigError, unknown_name
from hts.explain import Location, dotted, explain
from hts.guarded import guarded
from hts.layers import in_full as written_out
from hts.layers import laid, plain
from hts.overrides import Override, check_has_keys, nested, parsed
from hts.parts import make_model, objectives_of, robot_of, world_of
from hts.presets import (
    ASKS_OBJECTIVES,
    BASELINES,
    BASELINES_OF_SEVERAL,
    DEFAULT,
    IN_SIMULATION,
    ORACLES,
    PRESETS,
    SEVERAL,
)
from hts.task_settings import check_simulated, check_task, task_layer
from hts.yaml_text import load_mapping_file

if TYPE_CHECKING:
    from hts.plugins import Registry

Section = TypeVar("Section", bound=Config)

EXECUTORS = ("local",)

SOURCES = ("model", "proxy")
"""What a run's reward may come from; `oracle` is for `hts oracle` alone."""

NO_OBJECTIVE = "No objective given. Say which quantity to improve: --objective NAME (`hts plugins` lists them)."
NO_ROBOT = "No robot given. Say which machine: --robot NAME (`hts plugins` lists them)."


def load_config(
    *,
    preset: str | None = None,
    file: Path | None = None,
    objectives: Sequence[str] = (),
    robot: str | None = None,
    world: str | None = None,
    engine: str | None = None,
    executor: str | None = None,
    seed: int | None = None,
    reward_source: str | None = None,
    baseline: bool = False,
    oracle: bool = False,
    start: str | None = None,
    overrides: Sequence[str | Override] = (),
    registry: Registry | None = None,
    option_names: Mapping[str, str] | None = None,
) -> RunConfig:
    """The configuration of a run. Raises ConfigError, one line, for anything that is wrong with it.

    objectives: if any are given, exactly these; settings for them still come from the file. baseline: the sweep and the
    budget of `hts baseline`, with the analytic proxy as reward; oracle: likewise of `hts oracle`, paid from inside.
    overrides: KEY=VALUE each, the key dotted, the value as YAML; or such a pair already taken apart.
    registry: all that is installed. None: the robot is not asked for its task, and presets' speeds stay; it is loaded
    only for presets that ask objectives for settings of their own.
    option_names: key -> the option by which a command gives it, for messages: "reward_source" -> "--reward".
    """
    sets = parsed(overrides)
    written = written_out(load_mapping_file(file), str(file)) if file else {}
    last = nested(sets, written_out)
    if "preset" in last:
        text = next(one.text for one in sets if one.path[0] == "preset")
        raise ConfigError(f"{text}: a preset is where the other values start from; say --preset {last['preset']}")
    chosen = preset or written.get("preset") or DEFAULT
    if not isinstance(chosen, str) or chosen not in PRESETS:
        raise ConfigError(unknown_name("preset", str(chosen), PRESETS))
    _check_preset(chosen, written, file)

    given: dict[str, Any] = {"robot": robot and {"name": robot}, "world": world and {"name": world}}
    given |= {"engine": engine, "executor": executor, "seed": seed, "reward_source": reward_source}
    given |= {"start": start}
    options = {key: value for key, value in given.items() if value is not None}
    names = _objectives(objectives, written, last, sets)
    several = SEVERAL[chosen] if len(names) > 1 else {}
    baselines = BASELINES_OF_SEVERAL if several else BASELINES
    without = {**baselines[chosen], "reward_source": "proxy"} if baseline else {}
    if oracle:
        simulated = laid(written, last).get("oracle_trains_in") == "simulation"
        without = {**(IN_SIMULATION if simulated else ORACLES[chosen]), "reward_source": "oracle"}
    own = {"objectives": _of_objectives(names, chosen, registry)} if chosen in ASKS_OBJECTIVES else {}
    machine = laid(written, options, last).get("robot") if registry else None
    task = task_layer(registry, machine, PRESETS[chosen]) if registry and machine else {}
    layers = (PRESETS[chosen], own, several, without, task, written, options)
    below = laid(*layers)
    for override in sets:
        check_has_keys(below, override)
    values = laid(*layers, last)  # all at once: only then is it known whose settings a layer without a name holds
    values["preset"] = chosen
    values["objectives"] = {name: (values.get("objectives") or {}).get(name, {}) for name in names}
    origin = _origin(file, written, sets, {key: name for key, name in (option_names or {}).items() if key in options})
    _check_speed(laid(written, last), values, origin)
    _check_source(values.get("reward_source", "model"), origin, oracle)
    return _whole(values, origin)


def _check_preset(chosen: str, written: Mapping[str, Any], file: Path | None) -> None:
    """Raise ConfigError for another preset than a file's that says all of its own, as the config.yaml of a run does:
    the run would be called by the one preset and be the other."""
    own = written.get("preset")
    if isinstance(own, str) and own in PRESETS and own != chosen and laid(PRESETS[own], written) == written:
        raise ConfigError(
            f"--preset {chosen}: {file} says all that preset '{own}' does, as a run writes it, so little of '{chosen}' "
            "would be left. Leave --preset out, or give a file that names only what is to be otherwise."
        )


def _check_speed(user: Mapping[str, Any], values: Mapping[str, Any], origin: Callable[[Location], str]) -> None:
    """Raise ConfigError if a user names the one speed of trials where the preset has several, which take its place.

    user: what files and options say; values: all of it.
    """
    own, speeds = user.get("selection"), (values.get("selection") or {}).get("speeds")
    if isinstance(own, Mapping) and "speed" in own and "speeds" not in own and speeds:
        where = origin(("selection", "speed"))
        raise ConfigError(
            f"{where}: says {own['speed']}, but elites are tried at selection.speeds, {list(speeds)}, so it would do "
            f"nothing. Say --set selection.speeds=[{own['speed']}]"
        )


def _check_source(found: Any, origin: Callable[[Location], str], oracle: bool) -> None:
    """Raise ConfigError for a reward that comes from nowhere. The other command's own is refused where it begins, with
    what to do instead."""
    if found not in (*SOURCES, "oracle"):
        expected = "oracle" if oracle else " or ".join(SOURCES)
        raise ConfigError(f"{origin(('reward_source',))}: expected {expected}, found {found!r}.")


def _of_objectives(names: Sequence[str], preset: str, registry: Registry | None) -> dict[str, Mapping[str, Any]]:
    """What the objectives' plugins say of themselves for a preset, see `hts_objectives`."""
    if registry is None:
        from hts import plugins

        registry = plugins.load()
    offered = registry.offered("objectives")  # a name that is not among them is refused later, with the closest one
    return {name: offered[name].presets.get(preset, {}) for name in names if name in offered}


def load_section(
    model: type[Section],
    file: Path | None,
    given: Mapping[str, Any],
    overrides: Sequence[str | Override] = (),
    option_names: Mapping[str, str] | None = None,
) -> Section:
    """A configuration model of its own (no presets): its defaults < file < given < overrides. Raises ConfigError.

    option_names: as of `load_config`.
    """
    sets = parsed(overrides)
    written = load_mapping_file(file) if file else {}
    options = {key: name for key, name in (option_names or {}).items() if key in given}
    return section_of(model, laid(written, given, nested(sets)), _origin(file, written, sets, options))


def section_of(model: type[Section], values: Mapping[str, Any], origin: Callable[[Location], str]) -> Section:
    """The model of these values. Raises ConfigError; origin: says of a key where it was written."""
    try:
        return model.model_validate(values)
    except ValidationError as error:
        raise ConfigError(explain(error, model, origin)) from error


def read_config(file: Path) -> RunConfig:
    """A resolved configuration, as `dump_config` wrote it; presets are not looked at. Raises ConfigError, which says
    how to get the file back: nobody writes it by hand."""
    if not file.exists():
        return section_of(RunConfig, load_mapping_file(file), str)
    try:
        return section_of(RunConfig, load_mapping_file(file), lambda location: f"{file}: {dotted(location)}")
    except ConfigError as error:
        wrote = file.with_name("provenance.json")
        version = f"; {wrote} names the version of hts that wrote it (packages, hard-to-sim)" if wrote.exists() else ""
        raise ConfigError(f"{error} Put {file} back as the run wrote it{version}.") from error


def dump_config(config: RunConfig) -> str:
    """The resolved configuration as YAML text; `read_config` reads it back to an equal one."""
    return yaml.safe_dump(plain(config.model_dump()), sort_keys=False, allow_unicode=True)


def with_plugin_defaults(config: RunConfig, registry: Registry) -> RunConfig:
    """The same configuration with every setting of its plugins written out, also those left at their defaults."""
    from hts.plugin_settings import in_full

    def named(kind: str, one: Named) -> Named:
        return Named(name=one.name, **in_full(registry, kind, one.name, one.settings))

    objectives: dict[str, dict[str, Any]] = {}
    for name, given in config.objectives.items():
        model = named("measurement_models", chosen_model(registry.make_objective(name, given), given))
        own = in_full(registry, "objectives", name, own_settings(given))
        objectives[name] = {**own, MODEL: {"name": model.name, **model.settings}}
    selection = config.selection.model_copy(update={"selector": named("selectors", config.selection.selector)})
    changes = {"robot": named("robots", config.robot), "world": named("worlds", config.world)}
    return config.model_copy(update={"objectives": objectives, "selection": selection, **changes})


def check_names(config: RunConfig, registry: Registry) -> None:
    """Every plugin that the configuration names is installed. Raises ConfigError with the closest name.

    Each is also made once, so that wrong settings show before anything is spent.
    """
    check_engine(config.engine)
    if config.executor not in EXECUTORS:
        raise ConfigError(unknown_name("executor", config.executor, EXECUTORS))
    objectives, robot = objectives_of(config, registry), robot_of(config, registry)
    check_simulated(robot)
    check_task(config, robot)
    checked_selector(registry, config.selection.selector).check(list(config.objectives))
    with tempfile.TemporaryDirectory() as nowhere:
        world_of(config, registry, Path(nowhere)).close()
    instruments = config.world.settings.get("instruments", {})
    for name, settings in instruments.items() if isinstance(instruments, Mapping) else ():
        registry.make_instrument(name, settings, robot)
    strangers = sorted(set(config.sweep.weights) - set(config.objectives))
    if strangers:
        raise ConfigError("sweep.weights: " + unknown_name("objective of this run", strangers[0], config.objectives))
    if config.fits_models:
        for name, objective in objectives.items():
            what = f"Objective '{name}' (from {registry.entry('objectives', name).package}): measurement_model()"
            guarded(what, objective.measurement_model)
            make_model(registry, objective, config.objectives[name], robot)


def _objectives(
    chosen: Sequence[str], written: Mapping[str, Any], last: Mapping[str, Any], sets: Sequence[Override]
) -> list[str]:
    """Names of the run's objectives, in order. Raises ConfigError if one is chosen twice, or if --set has settings for
    another one."""
    name, count = next(iter(Counter(chosen).most_common(1)), ("", 0))
    if count > 1:
        raise ConfigError(
            f"Objective '{name}' is named {count} times, expected each once: a run weighs objectives by λ "
            f"(sweep.weights.{name}), not by how often they are named. Name it once."
        )
    whole = any(override.path == ("objectives",) for override in sets)
    names = list(chosen) or list(written.get("objectives") or {})
    if whole and not chosen:
        names = list(dict.fromkeys([*names, *last["objectives"]]))
    for name in last.get("objectives") or {}:
        if name not in names:
            text = next(
                one.text for one in sets if one.path[0] == "objectives" and (len(one.path) == 1 or one.path[1] == name)
            )
            raise ConfigError(f"{text}: " + unknown_name("objective of this run", name, names))
    return names


def _whole(values: dict[str, Any], origin: Callable[[Location], str]) -> RunConfig:
    """The configuration, if nothing is wrong or missing. What is wrong is said first: it may be a misspelt `robot`."""
    missing = [text for key, text in (("objectives", NO_OBJECTIVE), ("robot", NO_ROBOT)) if not values.get(key)]
    if missing:
        stand_in = {"objectives": values.get("objectives") or {"-": {}}, "robot": values.get("robot") or {"name": "-"}}
        section_of(RunConfig, {**values, **stand_in}, origin)
        raise ConfigError(missing[0])
    return section_of(RunConfig, values, origin)


def _origin(
    file: Path | None, written: Mapping[str, Any], sets: Sequence[Override], options: Mapping[str, str]
) -> Callable[[Location], str]:
    """A function that says of a location where its value was written: by --set or another option, in the file, or in
    the preset. options: key -> option, of those that were given."""

    def origin(location: Location) -> str:
        named = tuple(str(part) for part in location)
        for one in sets:
            if named[: len(one.path)] == one.path or one.path[: len(named)] == named:
                if one.option is not None:
                    return one.option
                return f"--set {dotted(location)}" if one.text.startswith("--set") else dotted(location)
        if named and named[0] in options:
            return options[named[0]]
        return f"{file}: {dotted(location)}" if location and location[0] in written else dotted(location)

    return origin
