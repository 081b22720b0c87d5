"""Which instruments a twin carries: those that the run's objectives name, and those that its settings name."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from hts.contracts import Instrument, Robot, Settings
from hts.errors import ConfigError, UnfitWorldError, unknown_name

if TYPE_CHECKING:
    from hts.plugins import Registry


def instrument_names(registry: Registry, objectives: Mapping[str, Settings]) -> list[str]:
    """Instruments of the objectives, each once. Raises UnfitWorldError for an objective that names none."""
    names: dict[str, None] = {}
    for name, settings in objectives.items():
        instrument = registry.make_objective(name, settings).instrument
        if instrument is None:
            raise UnfitWorldError(
                f"Objective '{name}' names no instrument, so a twin cannot measure it. "
                "Set `instrument` in the objective's class, or start a run in another world: --world field."
            )
        names[instrument] = None
    return list(names)


def make_instruments(
    registry: Registry, robot: Robot, objectives: Mapping[str, Settings], settings: Mapping[str, Mapping[str, Any]]
) -> dict[str, Instrument]:
    """Instruments by name. settings: name -> settings; a name that is no instrument at all is refused."""
    for name in settings:
        if name not in registry.instruments:
            raise ConfigError("world.instruments: " + unknown_name("instrument", name, registry.instruments))
    names = dict.fromkeys([*instrument_names(registry, objectives), *settings])
    return {name: registry.make_instrument(name, settings.get(name, {}), robot) for name in names}
