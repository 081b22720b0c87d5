"""A call of a plugin's factory: it gives what its contract says, or one line names the plugin and its package."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

from hts import contracts, units
from hts.channels import Channel
from hts.contracts import MeasurementModel, Objective, Robot, RobotSpec
from hts.contracts.spec_faults import fault_of_spec
from hts.errors import ConfigError, HtsError, PluginError
from hts.explain import explain
from hts.guarded import guarded

CONTRACTS: Mapping[str, type] = {
    "objectives": contracts.Objective,
    "measurement_models": contracts.MeasurementModel,
    "robots": contracts.Robot,
    "worlds": contracts.World,
    "instruments": contracts.Instrument,
    "selectors": contracts.Selector,
    "log_readers": contracts.LogReader,
}
"""Kind, as in `hts.plugins.KINDS` -> what its factories give."""


def made_by(factory: Callable[..., Any], kind: str, who: str, name: str, package: str, *given: Any) -> Any:
    """What the factory gives; who: "objective 'heat'"; name: as registered; given: its settings and what its kind gets
    beside them.

    Raises ConfigError for settings that pydantic refuses, what the factory raises of hts.errors, and PluginError for
    anything else that goes wrong in it, or that is not what the kind's contract asks for.
    """
    from pydantic import ValidationError

    remedy = f"Mend {package}, or take it away: pip uninstall {package}"
    try:
        made = factory(*given)
    except HtsError:
        raise
    except ValidationError as error:
        also = (contracts.MODEL,) if kind == "objectives" else ()
        raise ConfigError(f"Settings of {who} (from {package}): {explain(error, also=also)}") from error
    except Exception as error:
        text = " ".join(str(error).split())
        raise PluginError(
            f"{_begun(who, package)} cannot be made, {type(error).__name__}: {text.rstrip('.')}. {remedy} "
            "(HTS_DEBUG=1 shows where)."
        ) from error
    if not isinstance(made, CONTRACTS[kind]):  # `return`, a pair of brackets or the base class is missing
        found = f"the class {made.__name__} itself" if isinstance(made, type) else f"a {type(made).__name__}"
        raise PluginError(
            f"{_begun(who, package)}: its factory gives {found}, not a hts.contracts.{CONTRACTS[kind].__name__}. "
            f"{remedy}."
        )
    if isinstance(made, Objective):
        _check_parts(made, name, f"{_begun(who, package)}", remedy)
        _check_weights(made, _begun(who, package))
    if isinstance(made, Robot):
        _check_spec(made, name, _begun(who, package), remedy)
    return made


def check_settings_kept(model: MeasurementModel, given: Mapping[str, Any], who: str, package: str) -> None:
    """Raise PluginError unless the model's settings hold what it was made with: a saved model is made again by them.

    Compared are numbers, texts and truths; lists and mappings may be written in more ways than one.
    """
    begun = f"{_begun(who, package)}: its `settings`"
    held = guarded(begun, lambda: model.settings)
    if not isinstance(held, Mapping):
        return  # told where they are written down
    remedy = f"Expected all settings, as self.config.model_dump(mode='json') gives them. Mend {package}."
    for key, value in given.items():
        if key not in held:
            raise PluginError(f"{begun} hold no '{key}', though it was made with {key}={value!r}. {remedy}")
        found = held[key]
        numbers = isinstance(found, int | float) and isinstance(value, int | float)
        texts = isinstance(found, str) and isinstance(value, str)
        if (numbers or texts) and found != value:
            raise PluginError(f"{begun} hold {key}={found!r}, though it was made with {key}={value!r}. {remedy}")


def _begun(who: str, package: str) -> str:
    return f"{who[:1].upper()}{who[1:]} (from {package})"


def _check_parts(objective: Objective, name: str, who: str, remedy: str) -> None:
    """Raise PluginError for an objective that lacks what every page and command reads of it, or has another name."""
    lacking = [part for part in ("name", "unit", "inputs", "target") if part not in dir(objective)]
    if lacking:
        raise PluginError(f"{who}: its class sets no {', '.join(lacking)}, which every objective has. {remedy}.")
    if objective.name != name:  # its rewards would be looked for under the registered one
        raise PluginError(f"{who}: calls itself {objective.name!r}, expected the registered name, '{name}'. {remedy}.")
    if not isinstance(objective.unit, str):
        raise PluginError(f"{who}: unit is {objective.unit!r}, expected text, such as '1' for a fraction. {remedy}.")
    if not units.known(objective.unit):
        raise PluginError(f"{who}: unit: {units.unknown(objective.unit)} {remedy}.")
    _check_metric_units(objective, who, remedy)
    inputs = objective.inputs
    if not isinstance(inputs, (tuple, list)) or not inputs or not all(isinstance(one, str) for one in inputs):
        raise PluginError(
            f"{who}: inputs are {inputs!r}, expected names of channels, such as ('joint_torque',). {remedy}."
        )
    if len(set(inputs)) < len(inputs):
        raise PluginError(f"{who}: inputs are {', '.join(inputs)}, expected each channel once. {remedy}.")
    if not isinstance(objective.also_measured, (tuple, list)):
        raise PluginError(
            f"{who}: also_measured is a {type(objective.also_measured).__name__}, expected a tuple of "
            f"hts.channels.Channel; of one it is (channel,). {remedy}."
        )
    for channel in objective.real_channels:
        if not isinstance(channel, Channel):
            raise PluginError(f"{who}: measures {channel!r}, expected a hts.channels.Channel. {remedy}.")


def _check_metric_units(objective: Objective, who: str, remedy: str) -> None:
    """Raise PluginError unless they are names with units that hts knows."""
    named = objective.metric_units
    if not isinstance(named, Mapping) or not all(isinstance(part, str) for pair in named.items() for part in pair):
        raise PluginError(
            f"{who}: metric_units are {named!r}, expected names with units, such as {{'watts': 'W'}}. {remedy}."
        )
    for name, unit in named.items():
        if not units.known(unit):
            raise PluginError(f"{who}: metric_units of '{name}': {units.unknown(unit)} {remedy}.")


def _check_spec(robot: Robot, name: str, who: str, remedy: str) -> None:
    """Raise PluginError for a robot without a spec, which every command reads, or with numbers that fit no machine."""
    if "spec" not in dir(robot):
        raise PluginError(f"{who}: its class sets no spec, which every robot has. {remedy}.")
    spec = guarded(f"{who}: its spec", lambda: robot.spec)
    if not isinstance(spec, RobotSpec):
        raise PluginError(f"{who}: its spec is a {type(spec).__name__}, expected a hts.contracts.RobotSpec. {remedy}.")
    if spec.name != name:  # recordings and policies would be of that other one
        raise PluginError(f"{who}: its spec is called '{spec.name}', expected the registered name, '{name}'. {remedy}.")
    if fault := fault_of_spec(spec):
        raise PluginError(f"{who}: {fault}. Correct its RobotSpec.")


def _check_weights(objective: Objective, who: str) -> None:
    """Raise ConfigError for λ that are no finite numbers of at least 0: below 0 more of what is bad would be paid."""
    for what in ("weights", "baseline_weights", "proxy_weights"):
        values = getattr(objective, what)
        numbers = isinstance(values, (tuple, list)) and all(isinstance(one, (int, float)) for one in values)
        if not numbers or not all(math.isfinite(one) and one >= 0 for one in values):
            found = [float(one) for one in values] if numbers else repr(values)
            raise ConfigError(
                f"{who}: {what} are {found}; expected finite λ of at least 0, else more of what is "
                f"to be less would be rewarded. Change them in the package, or, where it has that setting, with --set "
                f"objectives.{objective.name}.{what}=[1.0]."
            )
