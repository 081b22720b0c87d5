"""Instruments: what they read of several robots at once."""

from __future__ import annotations

import json
from collections.abc import Mapping

import numpy as np

from hts.contracts import Instrument
from hts.plugins import Entry, Registry
from hts.testing.checks.ensure import ensure, listed, same
from hts.testing.checks.made_up import WORLDS, arrays, physics, sim_channels
from hts.testing.examples.robot.robot import Tiny

STEPS = 60  # of 1 ms: three control steps


def reads_its_channels(entry: Entry, registry: Registry) -> None:
    """Made without settings, it reads its channels, no sim channel, of all robots at once, as finite numbers."""
    instrument = _made(entry)
    named = {channel.name: channel for channel in instrument.channels}
    readings = _used(instrument)
    ensure(set(readings) == set(named), f"read() gives {listed(readings)}, its channels are {listed(named)}")
    ensure(
        not set(named) & set(sim_channels(registry)),
        f"{listed(set(named) & set(sim_channels(registry)))} is a sim channel",
    )
    for name, channel in named.items():
        shape, wanted = np.shape(readings[name]), (WORLDS, *channel.shape)
        ensure(shape == wanted, f"'{name}' has shape {shape} for {WORLDS} robots, not {wanted}")
        ensure(bool(np.isfinite(readings[name]).all()), f"'{name}' is not finite (NaN or inf)")


def knows_idle(entry: Entry, registry: Registry) -> None:
    """idle() gives a finite level for channels of its own, and for one at least."""
    instrument = _made(entry)
    _used(instrument)
    levels, names = instrument.idle(), {channel.name for channel in instrument.channels}
    ensure(bool(levels) and set(levels) <= names, f"idle() gives {listed(levels)}, its channels are {listed(names)}")
    for name, level in levels.items():
        ensure(bool(np.isfinite(level)), f"the idle level of '{name}' is {level}")


def repeats_itself(entry: Entry, registry: Registry) -> None:
    """The same steps from the same random numbers read the same, also after a reset of one that was used."""
    instrument = _made(entry)
    first = _used(instrument)
    for again in (_used(instrument), _used(_made(entry))):
        for name, values in first.items():
            ensure(same(values, again[name]), f"'{name}' differs from one time to the next")


def reads_each_robot_alone(entry: Entry, registry: Registry) -> None:
    """What it reads of one robot does not depend on how the others move."""
    first, other = (_used(_made(entry), others=others) for others in (1.0, 0.3))
    for name, values in first.items():
        ensure(same(values[0], other[name][0], 1e-9), f"'{name}' of a robot depends on the robots beside it")


def leaves_physics_alone(entry: Entry, registry: Registry) -> None:
    """step() only reads the sample: other instruments get the same one."""
    instrument = _made(entry)
    instrument.reset(WORLDS, np.random.default_rng(0))
    sample = physics(np.random.default_rng(1))
    before = {name: value.copy() for name, value in arrays(sample).items()}
    instrument.step(sample)
    changed = [name for name, value in arrays(sample).items() if not same(value, before[name])]
    ensure(not changed, f"step() changes {listed(changed)} in place")


def describes_itself(entry: Entry, registry: Registry) -> None:
    """settle() runs, and describe() gives values that JSON can hold: they go into the twin's hash."""
    instrument = _made(entry)
    _used(instrument)
    instrument.settle()
    json.dumps(instrument.describe(), allow_nan=False)


def tells_of_its_own_channels(entry: Entry, registry: Registry) -> None:
    """truth() tells of channels of its own alone, one finite number of each robot."""
    instrument = _made(entry)
    _used(instrument)
    told, names = instrument.truth(), {channel.name for channel in instrument.channels}
    ensure(set(told) <= names, f"truth() tells of {listed(set(told) - names)}, its channels are {listed(names)}")
    for name, values in told.items():
        ensure(np.shape(values) == (WORLDS,), f"the truth of '{name}' has shape {np.shape(values)}, not {(WORLDS,)}")
        ensure(bool(np.isfinite(values).all()), f"the truth of '{name}' is not finite (NaN or inf)")


def _made(entry: Entry) -> Instrument:
    instrument = entry.factory({}, Tiny())
    ensure(isinstance(instrument, Instrument), f"is a {type(instrument).__name__}, not a hts.contracts.Instrument")
    return instrument


def _used(instrument: Instrument, others: float = 1.0) -> Mapping[str, np.ndarray]:
    """What it reads after a reset and STEPS steps; others: factor on what all robots but the first do."""
    instrument.reset(WORLDS, np.random.default_rng(7))
    made_up = np.random.default_rng(1)
    factor = np.array([1.0] + [others] * (WORLDS - 1))[:, None]
    for _ in range(STEPS):
        sample = physics(made_up)
        for name in ("motor_torque", "joint_velocity", "foot_force", "foot_speed"):
            setattr(sample, name, getattr(sample, name) * factor)
        instrument.step(sample)
    return {name: np.array(value, dtype=float) for name, value in instrument.read().items()}


CHECKS = (
    reads_its_channels,
    knows_idle,
    repeats_itself,
    reads_each_robot_alone,
    leaves_physics_alone,
    describes_itself,
    tells_of_its_own_channels,
)
