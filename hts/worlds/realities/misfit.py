"""How far a twin is from a lab's own recordings: the worst of its figures, in tolerances.

    d = max_i |f_i - y_i| / w_i          y_i: figure i of the recordings, w_i its tolerance (like.py), f_i the twin's

What is cheap comes first, and what is beyond the bound ends it: idle levels cost nothing, standing half a second in
simulation, a walk two or more. Sessions are the same ones for every twin, so d is a function of the twin alone.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

from hts.config import ScheduleConfig
from hts.contracts import Instrument
from hts.errors import HtsError
from hts.recordings.recording import Recording
from hts.worlds.base import request_id, seed_sequence
from hts.worlds.realities.check import COLD_SESSIONS, OF_THE_ROBOT, Stage, Tried, standing, walked
from hts.worlds.realities.like import Figure, Likeness, facts_of, shown_by, shown_idle
from hts.worlds.realities.sampler import Found
from hts.worlds.twin.instruments import Unread
from hts.worlds.twin.programme import Block, Session, standing_up
from hts.worlds.twin.reality import Measured
from hts.worlds.twin.session import Batch

WARM = Stage(warm=6.0, measured=6.0, sessions=2)


def free_distance(figures: Sequence[Figure], instruments: Mapping[str, Instrument]) -> float:
    """Of the idle levels alone, without any simulation; 0 where nothing is known of them."""
    return _distance(figures, shown_idle(figures, instruments))


def misfit(twin: Tried, policy: str, like: Likeness, bound: float = math.inf) -> Found:
    """Distance of a twin and what it shows; infinite for one that falls or breaks down, and where it was given up as
    beyond the bound. policy: exported (ONNX)."""
    used = replace(twin, instruments=_used(twin, like.figures))
    shown = shown_idle(like.figures, used.instruments)
    distance = _distance(like.figures, shown)
    try:
        for stage in (
            lambda: _standing(used, like.figures),
            lambda: _walking(used, policy, like, bound),
        ):
            if distance > bound:
                return Found(math.inf, shown, _worst(like.figures, shown))
            values, fallen = stage()
            shown |= values
            if fallen:
                return Found(math.inf, shown, fallen)
            distance = max(distance, _distance(like.figures, values))
    except OF_THE_ROBOT:
        raise
    except (HtsError, FloatingPointError) as error:  # such as motors that warm up without end
        return Found(math.inf, shown, str(error))
    return Found(distance if distance <= bound else math.inf, shown, _worst(like.figures, shown))


def measured_of(figures: Sequence[Figure], found: Found) -> tuple[Measured, ...]:
    """What was shown, each beside what agrees."""
    return tuple(
        Measured(name=one.name, value=found.shown[one.name], low=one.low, high=one.high, unit=one.unit)
        for one in figures
        if one.name in found.shown
    )


def in_tolerances(figure: Figure, value: float) -> float:
    """How far a value is from the figure; infinite for what is no number."""
    width = max((figure.high - figure.low) / 2, 1e-12)
    distance = abs(value - figure.value) / width
    return distance if math.isfinite(distance) else math.inf


def _distance(figures: Sequence[Figure], shown: Mapping[str, float]) -> float:
    return max((in_tolerances(one, shown[one.name]) for one in figures if one.name in shown), default=0.0)


def _worst(figures: Sequence[Figure], shown: Mapping[str, float]) -> str:
    """The figure that is furthest away, as a reason."""
    worst = max((one for one in figures if one.name in shown), key=lambda one: in_tolerances(one, shown[one.name]))
    return f"{worst.name} {shown[worst.name]:.4g} {worst.unit}"


def _used(twin: Tried, figures: Sequence[Figure]) -> dict[str, Instrument]:
    """Instruments that figures are of, and who simulates the supply where torque follows it; others cost time only."""
    read, instruments = {one.instrument for one in figures}, twin.instruments
    used = {name: one for name, one in instruments.items() if name in read}
    if twin.settings.dynamics.structure.torque_follows_supply and all(one.supply() is None for one in used.values()):
        used |= {name: Unread(one) for name, one in instruments.items() if one.supply() is not None}
    return used


def _standing(twin: Tried, figures: Sequence[Figure]) -> tuple[dict[str, float], str]:
    facts = [one for one in facts_of(figures, twin.instruments) if one.speed == 0]
    return (standing(twin, facts), "") if facts else ({}, "")


def _walking(twin: Tried, policy: str, like: Likeness, bound: float) -> tuple[dict[str, float], str]:
    if like.schedule is not None:
        return _from_cold(twin, policy, like.schedule, like.figures, bound)
    facts = [one for one in facts_of(like.figures, twin.instruments) if one.speed > 0]
    speeds = sorted({one.speed for one in facts})
    middle = speeds[len(speeds) // 2]  # most like all others, so a draw that is far off ends there
    shown: dict[str, float] = {}
    for some in ([middle], [speed for speed in speeds if speed != middle]):
        if some and _distance(like.figures, shown) <= bound:
            own = [one for one in facts if one.speed in some]
            values, fallen = walked(twin, own, policy, some, WARM)
            shown |= values
            if fallen:
                return shown, fallen
    return shown, ""


def _from_cold(
    twin: Tried, policy: str, schedule: ScheduleConfig, figures: Sequence[Figure], bound: float
) -> tuple[dict[str, float], str]:
    """As the lab recorded: the schedule from its first second on, one command after the other, to the first beyond."""
    request = request_id("as recorded", schedule.model_dump_json())
    batch = Batch(twin.robot, twin.settings, twin.instruments, COLD_SESSIONS, seed_sequence(0, request))
    made: list[Recording] = []
    shown: dict[str, float] = {}
    used = {name: one for name, one in twin.instruments.items() if not isinstance(one, Unread)}
    try:
        for number, command in enumerate(schedule.commands):
            part = Block(policy=policy, schedule=ScheduleConfig(commands=(command,)))
            blocks = (standing_up(), part) if number == 0 else (part,)
            rows = batch.run([Session(id=f"{request}-{world}", blocks=blocks) for world in range(COLD_SESSIONS)], "")
            made += [row[-1] for row in rows]
            if any(one.fell for one in made):
                return shown, "fell as the recordings' schedule was walked"
            shown = shown_by(made, figures, used)
            if _distance(figures, shown) > bound:
                break
    finally:
        batch.close()
    return shown, ""
