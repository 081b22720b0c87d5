"""From lying to standing and back, from pose to pose without a jerk."""

from __future__ import annotations

import math

import numpy as np

from hts_go1_runtime.link import DAMPING, Command
from hts_go1_runtime.loop import Loop
from hts_go1_runtime.machine import SIT, STAND
from hts_go1_runtime.reach import Reach

STAND_KP, STAND_KD = np.full(12, 40.0), np.full(12, 1.0)
FAR = 0.6  # rad: from further away the robot folds its legs before it stands up
UP_SECONDS, DOWN_SECONDS, STAND_SECONDS, LETTING_GO = 2.0, 2.0, 1.0, 1.0


def stand_up(loop: Loop, reach: Reach) -> None:
    """From the pose it is in."""
    start = loop.state.q.copy()
    _blend(loop, reach, start, start, 0.5, rising=True)
    if np.abs(start - STAND).max() > FAR:
        _blend(loop, reach, start, SIT, 1.0)
        start = SIT
    _blend(loop, reach, start, STAND, UP_SECONDS)
    _blend(loop, reach, STAND, STAND, STAND_SECONDS)


def sit_down(loop: Loop, reach: Reach) -> None:
    """From the pose it is in, until it is let go."""
    here = loop.state.q.copy()
    _blend(loop, reach, here, STAND, 0.8)
    _blend(loop, reach, STAND, SIT, DOWN_SECONDS)
    _blend(loop, reach, SIT, SIT, LETTING_GO, rising=False)


def _blend(
    loop: Loop, reach: Reach, begin: np.ndarray, end: np.ndarray, seconds: float, rising: bool | None = None
) -> None:
    """rising: gains grow from nothing (True), or stiffness falls to nothing and damping grows to that of the safe
    command (False): let go undamped, the legs would fall against their stops."""
    steps = max(1, round(reach.blend_seconds(begin, end, seconds) / loop.period))
    for number in range(1, steps + 1):
        share = 0.5 - 0.5 * math.cos(math.pi * number / steps)
        strength = 1.0 if rising is None else share if rising else 1.0 - share
        pose = reach.inside(begin + share * (end - begin))
        braking = DAMPING.kd - strength * (DAMPING.kd - STAND_KD) if rising is False else strength * STAND_KD
        command = Command(pose, strength * STAND_KP, braking)
        loop.tick(lambda _, sent=command: sent)  # type: ignore[misc]
