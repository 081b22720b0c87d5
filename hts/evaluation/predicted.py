"""What a candidate should save in reality, as its measurement model sees it in simulation.

The same arithmetic as for a head-to-head: the objective scores 1 s pieces and compares means (`Objective.score`,
`Objective.compare`), only that the real channels of the pieces are predicted. So promise and measurement have one unit
and one meaning, and their ratio says how far the model can be trusted (`hts.run.trust_region`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from hts.contracts import VELOCITY, Comparison, Task
from hts.errors import EvaluationError, PluginError, unknown_name
from hts.evaluation.scoring import as_scores, plain
from hts.guarded import guarded

if TYPE_CHECKING:
    from hts.contracts import Objective
    from hts.recordings.recording import Recording


@dataclass(frozen=True)
class PredictedSegments:
    """Predicted 1 s pieces, S of them, with what an objective asks of measured ones (`segments.Segments`).

    channels: name -> (S, n), n samples a piece; speed, commanded: (S,), m/s, or as the task has it;
    levels: idle level of each real channel;
    mass: kg, None if no recording says it.
    """

    channels: Mapping[str, np.ndarray]
    speed: np.ndarray
    commanded: np.ndarray
    levels: Mapping[str, float]
    mass: float | None

    def __len__(self) -> int:
        return len(self.speed)

    def values(self, channel: str) -> np.ndarray:
        """The channel in each piece, (S, n). Raises EvaluationError for one that nobody predicts."""
        if channel not in self.channels:
            raise EvaluationError(
                "Its score reads what nothing predicts. "
                + unknown_name("channel", channel, self.channels)
                + " Let predicted_channels() of the objective say how it follows from the target; until then elites "
                "are chosen by mean reward."
            )
        return self.channels[channel]

    def idle(self, channel: str) -> np.ndarray:
        """Idle level in each piece, (S,), the mean over the known recordings."""
        if channel not in self.levels:
            raise EvaluationError(unknown_name("idle level", channel, self.levels))
        return np.full(len(self), self.levels[channel])

    @property
    def mass_kg(self) -> np.ndarray:
        """Mass of the robot, kg (S,), as the known recordings say."""
        if self.mass is None:
            raise EvaluationError("No recording says the robot's mass.")
        return np.full(len(self), self.mass)


def pieces(
    objective: Objective,
    target: np.ndarray,
    speed: np.ndarray,
    commanded: float,
    known: Sequence[Recording],
    tolerance: float = 0.1,
    task: Task = VELOCITY,
) -> PredictedSegments:
    """target: of one policy at one speed, in the target's unit, (S, n); speed: of each piece, m/s, or what else the
    task achieves (S,); known: the recordings that the model was fitted to. As on a robot, a piece counts if the task
    was done in it: within `tolerance` of the asked speed."""
    counts = np.asarray(task.done(speed, commanded, tolerance), dtype=bool)
    target, speed = target[counts], speed[counts]
    names = {name for recording in known for name in recording.idle}
    levels = {name: float(np.mean([r.idle[name] for r in known if name in r.idle])) for name in names}
    weights = [recording.mass_kg for recording in known if recording.mass_kg is not None]
    channels = _predicted_channels(objective, target, known)
    mass = float(np.mean(weights)) if weights else None
    return PredictedSegments(channels, speed, np.full(len(speed), commanded), levels, mass)


def _predicted_channels(
    objective: Objective, target: np.ndarray, known: Sequence[Recording]
) -> Mapping[str, np.ndarray]:
    """What the objective makes of its predicted target. Raises PluginError, which names it, for anything but samples of
    each piece."""
    what = f"Objective '{objective.name}': predicted_channels()"
    found = guarded(what, lambda: objective.predicted_channels(target, known))
    if not isinstance(found, Mapping):
        raise PluginError(f"{what} gave {type(found).__name__}, expected a dict of channel -> samples of each piece.")
    for name, values in found.items():
        if np.ndim(values) < 2 or len(values) != len(target):
            raise PluginError(
                f"{what} gave '{name}' in shape {np.shape(values)} for a target of {target.shape}; expected "
                f"({len(target)}, n, ...), the samples of each piece."
            )
    return found


def predicted_comparison(
    objective: Objective,
    policy: PredictedSegments,
    reference: PredictedSegments,
    tell: Callable[[str], None] = lambda why: None,
) -> Comparison | None:
    """A policy against its reference, both predicted at one speed. None where nothing is left to compare, where the
    objective's score asks for more than is predicted, or where the comparison is no finite number.

    tell: is told why, where a score cannot be made of what is predicted. Raises PluginError for a mistake in `score` or
    `compare`.
    """
    if not len(policy) or not len(reference):
        return None
    try:
        means = [_means(objective, each) for each in (policy, reference)]
    except EvaluationError as error:
        tell(str(error))
        return None

    def ask() -> Comparison | None:
        try:
            return objective.compare(*means)
        except (EvaluationError, ArithmeticError):  # a reference of 0, say: these means have no comparison
            return None

    given = guarded(f"Objective '{objective.name}': compare() of what is predicted", ask)
    if given is None:
        return None
    found = plain(objective, given)
    return found if math.isfinite(found.improvement) and math.isfinite(found.selection_score) else None


def _means(objective: Objective, segments: PredictedSegments) -> dict[str, float]:
    """Means of the objective's quantities. Raises EvaluationError where it looks at more than is predicted, PluginError
    for any other mistake and for what are no quantities."""
    who = f"Objective '{objective.name}'"

    def ask() -> Mapping[str, np.ndarray]:
        try:
            return objective.score(segments)  # type: ignore[arg-type]
        except ArithmeticError as error:
            raise EvaluationError(f"Its score of predicted seconds fails, {type(error).__name__}: {error}") from error
        except AttributeError as error:
            if not isinstance(error.obj, PredictedSegments):
                raise
            raise EvaluationError(f"Its score reads `{error.name}` of segments, which is not predicted.") from error

    scores = guarded(f"{who}: score() of what is predicted", ask)
    as_scores(who, scores, len(segments))
    return {name: float(np.mean(values)) for name, values in scores.items()}
