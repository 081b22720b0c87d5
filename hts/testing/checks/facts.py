"""Facts and readings of an instrument, which nobody asks for but who draws realities."""

from __future__ import annotations

import math

import numpy as np

from hts import units
from hts.channels import Channel
from hts.contracts import Fact, Reading, Robot
from hts.errors import HtsError
from hts.plugins import Entry, Registry
from hts.testing.checks.ensure import ensure, listed
from hts.testing.examples.robot.robot import Tiny
from hts.worlds.realities.read_off import read_off

SAMPLES = 100


def facts_can_be_read(entry: Entry, registry: Registry) -> None:
    """facts() and readings() have known units, bounds in order and channels that there are, and read one finite number
    of a recording; asked of all installed robots."""
    for robot in _robots(registry):
        try:
            instrument = entry.factory({}, robot)
        except HtsError:  # it is not for this robot
            continue
        channels = {**robot.channels(), **{channel.name: channel for channel in instrument.channels}}
        recorded, idle = _recorded(channels), {name: 1.0 for name in channels}
        for fact in instrument.facts():
            ensure(isinstance(fact, Fact), f"facts() gives a {type(fact).__name__}, expected hts.contracts.Fact")
            what = f"fact '{fact.name}'"
            ensure(units.known(fact.unit), f"{what}: {units.unknown(fact.unit)}")
            bounds = f"{fact.low:g} to {fact.high:g}"
            ensure(fact.low <= fact.high, f"{what}: its bounds are {bounds}, expected the lower one first")
            ensure(fact.speed >= 0, f"{what}: its speed is {fact.speed:g}, expected m/s of at least 0")
            value = read_off(fact, recorded, idle)
            ensure(math.isfinite(value), f"{what}: reads {value} of a recording of finite numbers")
        for reading in instrument.readings():
            ensure(
                isinstance(reading, Reading),
                f"readings() gives a {type(reading).__name__}, expected hts.contracts.Reading",
            )
            what = f"reading '{reading.name}'"
            ensure(units.known(reading.unit), f"{what}: {units.unknown(reading.unit)}")
            lacking = set(reading.channels) - set(channels)
            ensure(not lacking, f"{what}: reads {listed(lacking)}, neither of the robot nor of this instrument")
            value = read_off(reading, {} if reading.idle else recorded, idle)
            ensure(math.isfinite(value), f"{what}: reads {value} of a recording of finite numbers")


def _robots(registry: Registry) -> list[Robot]:
    """The kit's own, and those installed that can be made."""
    found: list[Robot] = [Tiny()]
    for name in registry.robots:
        try:
            found.append(registry.make_robot(name))
        except HtsError:  # told when that robot is checked
            continue
    return found


def _recorded(channels: dict[str, Channel]) -> dict[str, np.ndarray]:
    """Each channel, (T, *shape), between 0.5 and 1.5."""
    rng = np.random.default_rng(0)
    return {name: rng.uniform(0.5, 1.5, (SAMPLES, *channel.shape)) for name, channel in channels.items()}
