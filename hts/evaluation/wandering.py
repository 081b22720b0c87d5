"""How far a policy's speed wanders slowly about the speed that is held, measured and in simulation.

A command is found on a short stretch and then frozen, so what changes afterwards (a slope, wind, a floor that differs
from the one it was found on) moves the speed. Of the errors e of successive 1 s pieces of one block

    W = mean(e_k e_{k+2}) / v*²

keeps what lasts for seconds: the noise of a sensor of speed, and the sway of single strides, are independent from one
piece to the next but one and drop out, so W is the same quantity where speed is measured with and without noise.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from hts.contracts import Task
from hts.evaluation.segments import cut
from hts.evaluation.simulation import SimulatedTrial
from hts.recordings.recording import Recording

LAG = 2  # pieces


@dataclass(frozen=True)
class Wandered:
    """W of the blocks at one speed, and in how many sessions they were walked."""

    size: float
    sessions: int


def of_pieces(errors: np.ndarray, asked: float) -> float:
    """W of errors (S, n): S successive pieces of n stretches, m/s. NaN with too few pieces."""
    if errors.shape[0] <= LAG or errors.shape[1] == 0:
        return float("nan")
    return float(np.mean(errors[LAG:] * errors[:-LAG])) / asked**2


def measured(recordings: Sequence[Recording], task: Task) -> dict[float, Wandered]:
    """Asked speed -> the blocks at it whose speed was held; blocks that fell are left out, nothing without any."""
    found: dict[float, list[tuple[float, int, str]]] = {}
    for recording in recordings:
        if "held_command" not in recording.notes or recording.fell:
            continue
        pieces = cut([recording], speed_tolerance=float("inf"), task=task)
        for asked in np.unique(pieces.commanded):
            errors = (pieces.speed - asked)[pieces.commanded == asked]
            value = of_pieces(errors[:, None], float(asked)) if asked > 0 else float("nan")
            if np.isfinite(value):
                found.setdefault(float(asked), []).append((value, len(errors) - LAG, recording.session))
    return {
        asked: Wandered(
            float(np.average([value for value, _, _ in rows], weights=[count for _, count, _ in rows])),
            len({session for _, _, session in rows}),
        )
        for asked, rows in found.items()
    }


def simulated(trials: Sequence[SimulatedTrial]) -> Mapping[float, float]:
    """Asked speed -> W of one policy's trials; NaN where every instance fell."""
    found = {}
    for trial in trials:
        stood = trial.worlds - trial.falls
        errors = trial.piece_speed.reshape(-1, stood) - trial.speed if stood else np.empty((0, 0))
        found[trial.speed] = of_pieces(errors, trial.speed) if stood else float("nan")
    return found
