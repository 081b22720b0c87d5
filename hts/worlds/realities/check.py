"""Whether a twin agrees with public facts: its instruments' own, and that the robot's policy walks without a fall.

What is cheap comes first, and the first that fails ends it: statics take a tenth of a second, standing in simulation
half of one, a short walk one, a long walk eight. Statics and the short walk only drop what is outside by a margin, so
whether a draw is kept is up to the two others.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hts.config import EvaluationConfig
from hts.contracts import Fact, Instrument, Robot
from hts.errors import ConfigError, HtsError, PluginError, UnfitWorldError
from hts.recordings.recording import Recording
from hts.worlds.base import request_id, seed_sequence, walking
from hts.worlds.realities.quick import standing_values
from hts.worlds.realities.read_off import read_off
from hts.worlds.twin.model import build
from hts.worlds.twin.parameters import TwinSettings
from hts.worlds.twin.programme import Block, Session, warm_up
from hts.worlds.twin.reality import Measured
from hts.worlds.twin.session import Batch

Margin = tuple[float, float]  # factors on a fact's lower and upper bound


@dataclass(frozen=True)
class Tried:
    """A twin that is tried: its robot, its settings, resolved, and its instruments, all that simulate a part of it."""

    robot: Robot
    settings: TwinSettings
    instruments: Mapping[str, Instrument]


@dataclass(frozen=True)
class Stage:
    """Sessions in simulation: s of warm-up and s measured, so many at each speed, and how far outside is outside."""

    warm: float
    measured: float
    sessions: int
    margin: Margin = (1.0, 1.0)


COLD_SESSIONS = 2
STATICS: Margin = (0.7, 1.15)  # bumps and payloads add up to a quarter to it, friction takes away up to 8 % (79 draws)
STANDING = Stage(warm=2.0, measured=2.0, sessions=2)
GLANCE = Stage(warm=3.0, measured=5.0, sessions=1, margin=(0.88, 1.12))
OF_THE_ROBOT = (ConfigError, PluginError, UnfitWorldError)
"""What is no draw's fault, so that another draw would not mend it: a robot of which there is no twin."""
WALKING = Stage(warm=8.0, measured=15.0, sessions=2)


@dataclass(frozen=True)
class Verdict:
    """What was measured so far, and why it was dropped; "" if it is kept."""

    measured: tuple[Measured, ...]
    why: str

    @property
    def kept(self) -> bool:
        return not self.why


def check(twin: Tried, policy: Path) -> Verdict:
    """The verdict on a twin. policy: exported (ONNX)."""
    facts = _facts(twin.instruments)
    speeds = _speeds(facts)
    measured: tuple[Measured, ...] = ()
    try:
        if any(fact.speed == 0 for fact in facts):
            dynamics = twin.settings.dynamics
            values = standing_values(build(twin.robot, dynamics), twin.instruments, facts, dynamics.physics_dt)
            if why := _outside(_measured(facts, values), STATICS):
                return Verdict((), f"{why} by statics")
            values = standing(twin, facts)
            measured = _measured(facts, values)
            if why := _outside(measured, STANDING.margin):
                return Verdict(measured, why)
        for stage in (GLANCE, WALKING):
            values, why = walked(twin, facts, str(policy), speeds, stage)
            if why:
                return Verdict(measured, why)
            seen = _measured(facts, values)
            if why := _outside(seen, stage.margin):
                return Verdict((*measured, *seen), why)
    except OF_THE_ROBOT:
        raise
    except (HtsError, FloatingPointError) as error:  # such as motors that warm up without end
        return Verdict(measured, str(error))
    return Verdict((*measured, *seen), "")


def fallen_at(robot: Robot, instruments: Mapping[str, Instrument], policy: Path) -> tuple[Sequence[float], str]:
    """The speeds at which draws have to walk, m/s, and at which of them the default twin falls in a glance, in words,
    "" for none."""
    speeds = _speeds(_facts(instruments))
    return speeds, walked(Tried(robot, TwinSettings(), {}), [], str(policy), speeds, GLANCE)[1]


def _facts(instruments: Mapping[str, Instrument]) -> list[Fact]:
    return [fact for instrument in instruments.values() for fact in instrument.facts()]


def _speeds(facts: Sequence[Fact]) -> list[float]:
    return sorted({*EvaluationConfig().speeds, *(fact.speed for fact in facts if fact.speed > 0)})


def _measured(facts: Sequence[Fact], values: Mapping[str, float]) -> tuple[Measured, ...]:
    return tuple(
        Measured(name=fact.name, value=values[fact.name], low=fact.low, high=fact.high, unit=fact.unit)
        for fact in facts
        if fact.name in values
    )


def _outside(measured: Sequence[Measured], margin: Margin) -> str:
    """What lies outside its bounds; "" if nothing does."""
    outside = [one for one in measured if not margin[0] * one.low <= one.value <= margin[1] * one.high]
    return " and ".join(f"{one.name} {one.value:.3g} {one.unit}" for one in outside)


def standing(twin: Tried, facts: Sequence[Fact]) -> dict[str, float]:
    """Fact about standing -> value."""
    rows = _recorded(twin, None, [0.0], STANDING)
    return {fact.name: _value(fact, rows[0.0]) for fact in facts if fact.speed == 0}


def walked(
    twin: Tried, facts: Sequence[Fact], policy: str, speeds: Sequence[float], stage: Stage
) -> tuple[dict[str, float], str]:
    """Fact about walking -> value; and at which speeds a robot fell, warm-up included, in words, "" for none."""
    rows = _recorded(twin, policy, speeds, stage)
    fallen = ", ".join(f"{speed:g}" for speed in speeds if any(one.fell for row in rows[speed] for one in row))
    values = {fact.name: _value(fact, rows[fact.speed]) for fact in facts if fact.speed > 0}
    return values, f"fell at {fallen} m/s" if fallen else ""


def _recorded(
    twin: Tried, policy: str | None, speeds: Sequence[float], stage: Stage
) -> dict[float, list[list[Recording]]]:
    """Speed -> the recordings of each session: of its warm-up's blocks, and last the one that is measured."""
    cases = [speed for speed in speeds for _ in range(stage.sessions)]
    seeds = seed_sequence(0, request_id("check", stage.warm, stage.measured, stage.sessions))
    batch = Batch(twin.robot, twin.settings, twin.instruments, len(cases), seeds)
    programme = [
        Session(
            id=f"{speed:g}",
            blocks=(
                *(block.model_copy(update={"recorded": True}) for block in warm_up(policy, speed, stage.warm)),
                Block(policy=policy, schedule=walking(speed, stage.measured)),
            ),
        )
        for speed in cases
    ]
    try:
        rows = batch.run(programme, "twin")
    finally:
        batch.close()
    return {speed: [row for row, case in zip(rows, cases, strict=True) if case == speed] for speed in speeds}


def _value(fact: Fact, sessions: Sequence[Sequence[Recording]]) -> float:
    """Mean over the sessions, of what was recorded last in each."""
    last = [recordings[-1] for recordings in sessions]
    return float(np.mean([read_off(fact, {name: one.values(name) for name in one.channels}, one.idle) for one in last]))
