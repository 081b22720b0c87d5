"""Which instruments a twin carries: those that the run's objectives name, and those that its settings name."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

from hts.contracts import Instrument, PhysicsSample, Robot, Settings
from hts.errors import ConfigError, UnfitWorldError, unknown_name
from hts.guarded import guarded

if TYPE_CHECKING:
    import numpy as np

    from hts.plugins import Registry
    from hts.worlds.twin.parameters import TwinSettings


WORLDS = 3  # robots that instruments are tried on; no likely size of a channel, so that no shape fits by chance


def instrument_names(registry: Registry, objectives: Mapping[str, Settings]) -> list[str]:
    """Instruments of the objectives, each once. Raises UnfitWorldError for an objective that names none."""
    names: dict[str, None] = {}
    for name, settings in objectives.items():
        instrument = registry.make_objective(name, settings).instrument
        if instrument is None:
            raise UnfitWorldError(
                f"Objective '{name}' names no instrument, so a twin cannot measure it. "
                "Set `instrument` in the objective's class, or start a run in another world: --world "
                f"{' or '.join(sorted(set(registry.worlds) - {'twin'}))}."
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


def instruments_of_reality(
    registry: Registry,
    robot: Robot,
    objectives: Mapping[str, Settings],
    settings: Mapping[str, Mapping[str, Any]],
    supplied: bool,
) -> dict[str, Instrument]:
    """Those of the objectives, as a reality has them. supplied: torque depends on the supply, so the instrument that
    simulates it is there even where nobody reads it."""
    names = instrument_names(registry, objectives)
    made = {name: registry.make_instrument(name, settings.get(name, {}), robot) for name in names}
    if supplied and all(instrument.supply() is None for instrument in made.values()):
        for name in sorted(set(settings) & set(registry.instruments) - set(made)):
            other = registry.make_instrument(name, settings[name], robot)
            if other.supply() is not None:
                made[name] = Unread(other)
                break
    return made


def maker(
    registry: Registry, robot: Robot, objectives: Mapping[str, Settings], settings: TwinSettings
) -> Callable[[], dict[str, Instrument]]:
    """What makes fresh instruments of a twin, by name. settings: resolved. Raises ConfigError for wrong ones."""
    sags = settings.dynamics.structure.torque_follows_supply

    def make() -> dict[str, Instrument]:
        given = (registry, robot, objectives, settings.instruments)
        return instruments_of_reality(*given, sags) if settings.reality is not None else make_instruments(*given)

    make()
    return make


def check_readings(instruments: Mapping[str, Instrument], robot: Robot) -> None:
    """Raise UnfitWorldError for an instrument that does not give what its channels say: it is read once, after one
    made-up physics step of WORLDS robots that stand still, then of one, before any robot has walked."""
    for name, instrument in instruments.items():
        for worlds in (WORLDS, 1):
            _check_reading(name, instrument, robot, worlds)


def check_idle_levels(instruments: Mapping[str, Instrument], targets: Mapping[str, str]) -> None:
    """Raise UnfitWorldError for an instrument without idle levels that can be used: `idle()` gives finite numbers of
    its own channels, and that of each target which it measures, since savings are of what moving takes beyond it.

    targets: by name of the objective, the channel whose level is needed. Reset an instrument before.
    """
    for name, instrument in instruments.items():
        levels = guarded(f"Instrument '{name}': idle()", instrument.idle)
        own = [channel.name for channel in instrument.channels]
        if not isinstance(levels, Mapping):
            raise UnfitWorldError(
                f"Instrument '{name}': idle() gives {type(levels).__name__}, expected the level of each channel by "
                "name."
            )
        for objective, target in targets.items():
            if target in own and target not in levels:
                raise UnfitWorldError(
                    f"Instrument '{name}': idle() gives no level of '{target}', only "
                    f"{', '.join(sorted(map(str, levels))) or 'nothing'}, and objective '{objective}' needs it: what "
                    "it reads with electronics on and motors idle. Return it by the channel's name."
                )
        for channel, level in levels.items():
            if channel not in own:
                raise UnfitWorldError(
                    f"Instrument '{name}': idle() gives a level of '{channel}', which is no channel of it "
                    f"({', '.join(sorted(own))})."
                )
            if not _is_finite(level):
                raise UnfitWorldError(
                    f"Instrument '{name}': idle() gives {level!s:.40} for '{channel}', expected a finite number."
                )


def _is_finite(level: Any) -> bool:
    try:
        return not isinstance(level, str) and math.isfinite(level)
    except (TypeError, ValueError):
        return False


def _check_reading(name: str, instrument: Instrument, robot: Robot, worlds: int) -> None:
    import numpy as np

    joints, feet = (worlds, robot.spec.num_joints), (worlds, len(robot.spec.foot_sites))
    still = PhysicsSample(
        motor_torque=np.full(joints, 0.1),
        joint_velocity=np.zeros(joints),
        foot_force=np.ones(feet),
        foot_speed=np.zeros(feet),
        foot_mass=np.ones(feet),
        dt=robot.spec.physics_dt,
    )

    def read() -> Mapping[str, np.ndarray]:
        instrument.reset(worlds, np.random.default_rng(0))
        instrument.step(still)
        return instrument.read()

    robots = f"{worlds} robot{'s' if worlds > 1 else ''}"
    given = guarded(f"Instrument '{name}': reading it", read)
    for channel in instrument.channels:
        wanted = (worlds, *channel.shape)
        if channel.name not in given:
            raise UnfitWorldError(
                f"Instrument '{name}': read() gives no '{channel.name}', only "
                f"{', '.join(sorted(given)) or 'nothing'}. It must give every one of its channels."
            )
        found = np.shape(given[channel.name])
        if found != wanted:
            raise UnfitWorldError(
                f"Instrument '{name}': read() gives '{channel.name}' in shape {found} for {robots}; its "
                f"channel says {channel.shape} each, so {wanted}. Correct read(), or the shape of the Channel."
            )


class Wrapped(Instrument):
    """An instrument that goes on simulating its part of the machine, and shows something else."""

    def __init__(self, instrument: Instrument) -> None:
        self._instrument = instrument

    def reset(self, num_worlds: int, rng: np.random.Generator) -> None:
        self._instrument.reset(num_worlds, rng)

    def step(self, sample: PhysicsSample) -> None:
        self._instrument.step(sample)

    def advance(self, samples: PhysicsSample) -> None:
        self._instrument.advance(samples)

    def settle(self) -> None:
        self._instrument.settle()

    def supply(self) -> np.ndarray | None:
        return self._instrument.supply()

    def conditions(self) -> Mapping[str, np.ndarray]:
        return self._instrument.conditions()


class Unread(Wrapped):
    """One that nobody reads."""

    channels = ()

    def read(self) -> Mapping[str, np.ndarray]:
        self._instrument.read()  # works through the steps so far
        return {}

    def idle(self) -> Mapping[str, float]:
        return {}
