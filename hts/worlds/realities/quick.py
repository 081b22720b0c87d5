"""A quick look at a draw, before anything is simulated: what its instruments show of a robot that just stands there.

The torques are those of statics: no body moves, so it takes milliseconds where standing in simulation takes a second.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from hts.contracts import Fact, Instrument, PhysicsSample
from hts.worlds.realities.read_off import read_off
from hts.worlds.twin.model import Machine

SECONDS = 1.0  # of each of three stretches: two that settle heat, one that is read
CONTROL_STEPS = 20  # physics steps between two looks


def standing_values(
    machine: Machine, instruments: Mapping[str, Instrument], facts: Sequence[Fact], dt: float
) -> dict[str, float]:
    """Fact about standing -> its value, from statics."""
    spec, feet = machine.spec, len(machine.foot_mass)
    sample = PhysicsSample(
        motor_torque=machine.standing_torque[None].copy(),
        joint_velocity=np.zeros((1, spec.num_joints)),
        foot_force=np.full((1, feet), 9.81 * machine.total_mass / feet),
        foot_speed=np.zeros((1, feet)),
        foot_mass=machine.foot_mass[None].copy(),
        dt=dt,
    )
    shown: dict[str, list[np.ndarray]] = {}
    idle: dict[str, float] = {}
    for number, instrument in enumerate(instruments.values()):
        instrument.reset(1, np.random.default_rng(number))
        for stretch in range(3):
            for step in range(round(SECONDS / dt)):
                instrument.step(sample)
                if step % CONTROL_STEPS == 0:
                    read = instrument.read()
                    for name, value in read.items() if stretch == 2 else ():
                        shown.setdefault(name, []).append(np.asarray(value)[0])
            if stretch < 2:
                instrument.settle()
        idle |= instrument.idle()
    channels = {name: np.array(values) for name, values in shown.items()}
    return {fact.name: read_off(fact, channels, idle) for fact in facts if fact.speed == 0}
