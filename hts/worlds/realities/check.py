"""Whether a twin agrees with public facts: its instruments' own, and that the robot's policy walks without a fall.

What is cheap comes first: standing takes a second, walking ten. The first that fails ends it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hts.config import EvaluationConfig
from hts.contracts import Fact, Instrument, Robot
from hts.errors import HtsError
from hts.recordings.recording import Recording
from hts.worlds.base import seed_sequence, walking
from hts.worlds.twin.parameters import TwinSettings
from hts.worlds.twin.programme import Block, Session, warm_up
from hts.worlds.twin.reality import Measured
from hts.worlds.twin.session import Batch

STANDING = (4.0, 3.0)  # s: warm-up, measured
WALKING = (8.0, 15.0)
SESSIONS = 2  # at each speed


@dataclass(frozen=True)
class Verdict:
    """What was measured so far, and why it was dropped; "" if it is kept."""

    measured: tuple[Measured, ...]
    why: str

    @property
    def kept(self) -> bool:
        return not self.why


def check(robot: Robot, settings: TwinSettings, instruments: Mapping[str, Instrument], policy: Path) -> Verdict:
    """The verdict on a twin. policy: exported (ONNX); instruments: all that simulate a part of the machine."""
    facts = [fact for instrument in instruments.values() for fact in instrument.facts()]
    measured: list[Measured] = []
    speeds = sorted({*EvaluationConfig().speeds, *(fact.speed for fact in facts if fact.speed > 0)})
    for stage, walked in enumerate(([0.0], speeds)):
        path, seconds = (str(policy), WALKING) if walked != [0.0] else (None, STANDING)
        if path is None and not any(fact.speed == 0 for fact in facts):
            continue
        try:
            rows = _recorded(robot, settings, instruments, path, walked, seconds, stage)
        except (HtsError, FloatingPointError) as error:  # such as motors that warm up without end
            return Verdict(tuple(measured), f"{'walking' if path else 'standing'}: {error}")
        fallen = [speed for speed, recordings in rows.items() if any(r.fell for row in recordings for r in row)]
        if fallen:
            return Verdict(tuple(measured), f"fell at {', '.join(f'{speed:g}' for speed in fallen)} m/s")
        for fact in facts:
            if fact.speed in rows:
                value = _value(fact, [row[-1] for row in rows[fact.speed]])
                measured.append(Measured(name=fact.name, value=value, low=fact.low, high=fact.high, unit=fact.unit))
        outside = [one for one in measured if not one.low <= one.value <= one.high]
        if outside:
            return Verdict(tuple(measured), " and ".join(f"{one.name} {one.value:.3g} {one.unit}" for one in outside))
    return Verdict(tuple(measured), "")


def _recorded(
    robot: Robot,
    settings: TwinSettings,
    instruments: Mapping[str, Instrument],
    policy: str | None,
    speeds: Sequence[float],
    seconds: tuple[float, float],
    stage: int,
) -> dict[float, list[list[Recording]]]:
    """Speed -> recordings of each session's blocks, warm-up included: who falls there has fallen."""
    warm, length = seconds
    cases = [speed for speed in speeds for _ in range(SESSIONS)]
    batch = Batch(robot, settings, instruments, len(cases), seed_sequence(0, f"{stage:x}"))
    programme = [
        Session(
            id=f"{speed:g}",
            blocks=(
                *(block.model_copy(update={"recorded": True}) for block in warm_up(policy, speed, warm)),
                Block(policy=policy, schedule=walking(speed, length)),
            ),
        )
        for speed in cases
    ]
    try:
        rows = batch.run(programme, "twin")
    finally:
        batch.close()
    return {speed: [row for row, case in zip(rows, cases, strict=True) if case == speed] for speed in speeds}


def _value(fact: Fact, recordings: Sequence[Recording]) -> float:
    """Mean over the sessions."""
    values = [fact.reading({name: r.values(name) for name in r.channels}, r.idle) for r in recordings]
    return float(np.mean(values))
