"""What the kit itself offers as plugins, while `packages.kit_installed` is in force. Imports nothing heavy."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hts import hookimpl
from hts.testing.examples.measurement_model import plugin as measurement_model
from hts.testing.examples.objective import plugin as objective
from hts.testing.examples.robot import plugin as robot
from hts.testing.examples.selector import plugin as selector

if TYPE_CHECKING:
    from hts.contracts import Settings, World, WorldContext
    from hts.hookspecs import Register

HTS_API = 2


def make_known(settings: Settings, context: WorldContext) -> World:
    """World `known`: no physics, made-up recordings, a known answer."""
    from hts.testing import known_world

    return known_world.make_known(settings, context)


@hookimpl
def hts_objectives(register: Register) -> None:
    objective.hts_objectives(register)


@hookimpl
def hts_measurement_models(register: Register) -> None:
    measurement_model.hts_measurement_models(register)


@hookimpl
def hts_instruments(register: Register) -> None:
    objective.hts_instruments(register)


@hookimpl
def hts_robots(register: Register) -> None:
    robot.hts_robots(register)


@hookimpl
def hts_selectors(register: Register) -> None:
    selector.hts_selectors(register)


@hookimpl
def hts_worlds(register: Register) -> None:
    register("known", make_known)
