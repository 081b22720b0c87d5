"""From preset, config file, options and --set to one frozen RunConfig; and from a saved config back to it.

Later wins: preset < what several objectives change of it (`presets.SEVERAL`) < --config FILE < --objective, --robot,
--world, --engine, --executor, --seed < --set KEY=VALUE.
Mappings are merged key by key, anything else is replaced whole. A world, robot or selector of another
name drops the settings of the one before it.
"""

from __future__ import annotations

import copy
import tempfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import yaml
from pydantic import ValidationError

from hts.config import Config, RunConfig
from hts.contracts import MODEL, ModelContext, WorldContext, chosen_model, robot_signals
from hts.engines import check_engine
from hts.errors import ConfigError, unknown_name
from hts.explain import Location, dotted, explain
from hts.presets import BASELINES, DEFAULT, PRESETS, SEVERAL

if TYPE_CHECKING:
    from hts.contracts import Objective, Robot
    from hts.plugins import Registry

Section = TypeVar("Section", bound=Config)

EXECUTORS = ("local",)


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
    overrides: Sequence[str] = (),
) -> RunConfig:
    """The configuration of a run. Raises ConfigError, one line, for anything that is wrong with it.

    objectives: if any are given, exactly these; settings for them still come from the file.
    overrides: KEY=VALUE each, the key dotted, the value as YAML.
    """
    written = _read_yaml(file) if file else {}
    chosen = preset or written.get("preset") or DEFAULT
    if chosen not in PRESETS:
        raise ConfigError(unknown_name("preset", str(chosen), PRESETS))

    base = copy.deepcopy(PRESETS[chosen])
    if len(set(objectives) or written.get("objectives") or ()) > 1:
        base = merged(base, SEVERAL[chosen])
    base = merged(base, BASELINES[chosen] if reward_source == "proxy" else {})
    values = with_named_models(merged(base, with_named_models(written)))
    values["preset"] = chosen
    if objectives:
        settings = values.get("objectives") or {}
        values["objectives"] = {name: settings.get(name, {}) for name in objectives}
    for key, name in (("robot", robot), ("world", world)):
        if name is not None:
            values = merged(values, {key: {"name": name}})
    for key, value in (
        ("engine", engine),
        ("executor", executor),
        ("seed", seed),
        ("reward_source", reward_source),
    ):
        if value is not None:
            values[key] = value
    for override in overrides:
        values = _with_override(values, override)

    if not values.get("objectives"):
        raise ConfigError(
            "No objective given. Say which quantity to improve: --objective NAME (`hts plugins` lists them)."
        )
    if not values.get("robot"):
        raise ConfigError("No robot given. Say which machine: --robot NAME (`hts plugins` lists them).")
    return _validated(values, _origin(file, written, overrides))


def load_section(
    model: type[Section], file: Path | None, given: Mapping[str, Any], overrides: Sequence[str] = ()
) -> Section:
    """A configuration model of its own (no presets): its defaults < file < given < overrides. Raises ConfigError."""
    written = _read_yaml(file) if file else {}
    values = merged(written, given)
    for override in overrides:
        values = _with_override(values, override)
    try:
        return model.model_validate(values)
    except ValidationError as error:
        raise ConfigError(explain(error, model, _origin(file, written, overrides))) from error


def read_config(file: Path) -> RunConfig:
    """A resolved configuration, as `dump_config` wrote it; presets are not looked at. Raises ConfigError."""
    return _validated(_read_yaml(file), lambda location: f"{file}: {dotted(location)}")


def dump_config(config: RunConfig) -> str:
    """The resolved configuration as YAML text; `read_config` reads it back to an equal one."""
    return yaml.safe_dump(plain(config.model_dump()), sort_keys=False, allow_unicode=True)


def check_names(config: RunConfig, registry: Registry) -> None:
    """Every plugin that the configuration names is installed. Raises ConfigError with the closest name.

    Each is also made once, so that wrong settings show before anything is spent.
    """
    check_engine(config.engine)
    if config.executor not in EXECUTORS:
        raise ConfigError(unknown_name("executor", config.executor, EXECUTORS))
    for name, settings in config.objectives.items():
        registry.make_objective(name, settings)
    robot = registry.make_robot(config.robot.name, config.robot.settings)
    registry.make_selector(config.selection.selector.name, config.selection.selector.settings)
    with tempfile.TemporaryDirectory() as nowhere:
        context = WorldContext(
            robot=config.robot.name,
            robot_settings=config.robot.settings,
            objectives=config.objectives,
            seed=config.seed,
            folder=Path(nowhere),
            registry=registry,
        )
        registry.make_world(config.world.name, config.world.settings, context).close()
    instruments = config.world.settings.get("instruments", {})
    for name, settings in instruments.items() if isinstance(instruments, Mapping) else ():
        registry.make_instrument(name, settings, robot)
    strangers = sorted(set(config.sweep.weights) - set(config.objectives))
    if strangers:
        raise ConfigError("sweep.weights: " + unknown_name("objective of this run", strangers[0], config.objectives))
    if config.reward_source == "model":
        for name, settings in config.objectives.items():
            check_model(registry, registry.make_objective(name, settings), settings, robot)


def check_model(registry: Registry, objective: Objective, settings: Mapping[str, Any], robot: Robot) -> None:
    """The measurement model of an objective can be made for the robot's channels. Raises ConfigError."""
    choice, signals = chosen_model(objective, settings), robot_signals(objective, robot)
    context = ModelContext(signals, objective.measurement_model())
    registry.make_measurement_model(choice.name, choice.settings, context)


def merged(base: Mapping[str, Any], over: Mapping[str, Any]) -> dict[str, Any]:
    """`over` laid on `base`, mapping by mapping; a mapping with another `name` replaces instead of merging."""
    result = dict(base)
    for key, value in over.items():
        below = result.get(key)
        if isinstance(value, Mapping) and isinstance(below, Mapping):
            renamed = "name" in value and "name" in below and value["name"] != below["name"]
            result[key] = dict(value) if renamed else merged(below, value)
        else:
            result[key] = value
    return result


def with_named_models(values: Mapping[str, Any]) -> dict[str, Any]:
    """The same with every `objectives.NAME.model: MODEL` written out as `{name: MODEL}`, so that settings merge with it."""
    objectives = values.get("objectives")
    if not isinstance(objectives, Mapping):
        return dict(values)
    return {**values, "objectives": {name: with_named_model(one) for name, one in objectives.items()}}


def with_named_model(settings: Any) -> Any:
    """The same for what stands under one objective."""
    if isinstance(settings, Mapping) and isinstance(settings.get(MODEL), str):
        return {**settings, MODEL: {"name": settings[MODEL]}}
    return settings


def plain(value: Any) -> Any:
    """Tuples to lists and paths to text, all the way down: what YAML and JSON can write."""
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    return str(value) if isinstance(value, Path) else value


def _validated(values: Mapping[str, Any], origin: Callable[[Location], str]) -> RunConfig:
    try:
        return RunConfig.model_validate(values)
    except ValidationError as error:
        raise ConfigError(explain(error, RunConfig, origin)) from error


def _read_yaml(file: Path) -> dict[str, Any]:
    try:
        text = file.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise ConfigError(f"{file}: cannot read this config file ({reason}).") from error
    try:
        values = yaml.safe_load(text)
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        place = f"{file}:{mark.line + 1}" if mark else str(file)
        raise ConfigError(f"{place}: not YAML: {getattr(error, 'problem', None) or 'cannot be read'}.") from error
    if values is None:
        return {}
    if not isinstance(values, dict):
        raise ConfigError(f"{file}: expected keys and values, found a {type(values).__name__}.")
    return values


def _split_override(override: str) -> tuple[list[str], Any]:
    key, equals, text = override.partition("=")
    path = key.strip().split(".")
    if not equals or not all(path):
        raise ConfigError(f"--set {override}: expected KEY=VALUE, e.g. --set finetune.num_envs=128")
    try:
        return path, yaml.safe_load(text)
    except yaml.YAMLError as error:
        raise ConfigError(f"--set {override}: the value '{text}' is not YAML.") from error


def _with_override(values: Mapping[str, Any], override: str) -> dict[str, Any]:
    path, value = _split_override(override)
    if path[0] == "preset":
        raise ConfigError(f"--set {override}: a preset is where the other values start from; say --preset {value}")
    if path[0] == "objectives" and len(path) > 1 and path[1] not in (values.get("objectives") or {}):
        raise ConfigError(
            f"--set {override}: " + unknown_name("objective of this run", path[1], values.get("objectives") or {})
        )
    laid: Any = value
    for step in reversed(path):
        laid = {step: laid}
    laid, values = with_named_models(laid), with_named_models(values)
    below: Any = values
    for depth, step in enumerate(path[:-1]):
        below = below.get(step, {})
        if not isinstance(below, Mapping):
            raise ConfigError(f"--set {override}: '{'.'.join(path[: depth + 1])}' is a value, it has no keys inside.")
    return merged(values, laid)


def _origin(file: Path | None, written: Mapping[str, Any], overrides: Sequence[str]) -> Callable[[Location], str]:
    """A function that says of a location where its value was written: by --set, in the file, or in the preset."""
    set_paths = [tuple(_split_override(override)[0]) for override in overrides]

    def origin(location: Location) -> str:
        named = tuple(str(part) for part in location)
        for path in set_paths:
            if named[: len(path)] == path or path[: len(named)] == named:
                return f"--set {dotted(location)}"
        below: Any = written
        for part in location[:1]:
            below = below.get(part) if isinstance(below, Mapping) else None
        return f"{file}: {dotted(location)}" if below is not None else dotted(location)

    return origin
