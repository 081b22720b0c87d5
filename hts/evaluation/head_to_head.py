"""Head-to-head: a policy against its reference on one machine, as one number with an interval.

Blocks alternate in the order A-B-B-A: both policies then have the same mean time, so that anything that drifts
evenly (charge, heat) adds the same to both means and cancels. In A-B-A-B the second always comes later. Every block
counts the same for that (`hts.evaluation.balance`), however many of its seconds are valid.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from hts.config import EvaluationConfig
from hts.contracts import VELOCITY, Comparison, FollowVelocity, Objective, Task
from hts.errors import EvaluationError, HtsError, PluginError
from hts.evaluation.balance import Balance, in_common
from hts.evaluation.held import (
    NAMES,
    Commanded,
    NotComparable,
    check_apart,
    check_range,
    commanded,
    mean_speeds,
    refusal,
)
from hts.evaluation.scoring import check_finite, compared, scored
from hts.evaluation.segments import Segments, cut
from hts.evaluation.sessions import interval_of

if TYPE_CHECKING:
    from hts.recordings.recording import Recording


ROLES = ("policy", "reference")
ANY_SPEED = 1.0  # relative: a second at any forward speed up to twice the commanded one counts


class TooFewSegments(NotComparable):
    """Too few valid segments of the policy or of the reference."""


@dataclass(frozen=True)
class EverySecond:
    """The same comparison over every second that is not near a fall, whatever its speed up to twice the asked one.

    Who walks now faster, now slower loses seconds to the ±10 % that a valid segment may be off, and they are not its
    cheapest. mean_speed, reference_speed: over these seconds, m/s; no rule asks them to be one speed.
    """

    improvement: float
    improvement_ci95: tuple[float, float] | None
    mean_speed: float
    reference_speed: float

    def entry(self) -> dict[str, Any]:
        """This comparison's part of `summary.json`."""
        return {
            "improvement": self.improvement,
            "improvement_ci95": list(self.improvement_ci95) if self.improvement_ci95 else None,
            "mean_speed": self.mean_speed,
            "reference_mean_speed": self.reference_speed,
        }


@dataclass(frozen=True)
class HeadToHead:
    """A policy against its reference at one asked speed, or one set-point of another task.

    comparison: improvement, selection score and metrics by the objective; improvement_ci95: 95 % interval, over
    sessions where there are several, None if a single segment leaves nothing to tell it from, or if some draw cannot
    be compared; metrics_ci95: the same for each metric;
    policy_segments, reference_segments: the valid ones; policy_scores, reference_scores: the objective's quantities
    per segment, each (S,); commanded: what was sent to both, and whether the speed was held; every_second: the same
    without the rule that a second must be near the asked speed, None of a task that is not to follow a velocity, or
    where the objective has no number of such seconds.
    """

    speed: float
    unit: str
    comparison: Comparison
    improvement_ci95: tuple[float, float] | None
    metrics_ci95: Mapping[str, tuple[float, float] | None]
    policy_segments: Segments
    reference_segments: Segments
    policy_scores: Mapping[str, np.ndarray]
    reference_scores: Mapping[str, np.ndarray]
    commanded: Commanded
    every_second: EverySecond | None = None

    @property
    def improvement(self) -> float:
        """The objective's primary score of the policy against the reference, larger is better, in `unit`."""
        return self.comparison.improvement

    @property
    def falls(self) -> int:
        """Falls of the policy; the reference's are in `reference_segments.falls`."""
        return self.policy_segments.falls

    @property
    def mean_speed(self) -> float:
        """Of the policy over its valid segments, m/s; of another task what was achieved, in its unit."""
        return mean_speeds(self.policy_segments, self.reference_segments)[0]

    @property
    def reference_mean_speed(self) -> float:
        """The same of the reference."""
        return mean_speeds(self.policy_segments, self.reference_segments)[1]

    @property
    def valid(self) -> float:
        """Share of the policy's segments that count."""
        return self.policy_segments.valid

    def entry(self) -> dict[str, Any]:
        """This speed's part of `summary.json`."""
        return {
            "improvement": self.improvement,
            "improvement_ci95": list(self.improvement_ci95) if self.improvement_ci95 else None,
            "segments": len(self.policy_segments),
            "valid": self.valid,
            "falls": self.falls,
            "mean_speed": self.mean_speed,
            "held": self.commanded.held,
            "commanded": self.commanded.policy,
            "metrics": {name: float(value) for name, value in self.comparison.metrics.items()},
            "metrics_ci95": {name: list(found) if found else None for name, found in self.metrics_ci95.items()},
            "every_second": self.every_second.entry() if self.every_second else None,
            "reference": {
                "segments": len(self.reference_segments),
                "valid": self.reference_segments.valid,
                "falls": self.reference_segments.falls,
                "mean_speed": self.reference_mean_speed,
                "commanded": self.commanded.reference,
            },
        }


def compare(
    objective: Objective,
    recordings: Sequence[Recording],
    config: EvaluationConfig,
    seed: int = 0,
    task: Task = VELOCITY,
) -> HeadToHead:
    """One head-to-head, or several of the same two policies, at one commanded speed.

    recordings: blocks with role "policy" or "reference", in any order. Deterministic for a given seed.
    Raises EvaluationError, one line, when it would be dishonest to report: no blocks of one role, several commanded
    speeds, fewer than `config.min_valid` of the segments valid, fewer than `config.min_segments` of either policy, a
    quantity that is not a finite number, or a held speed that was not held (`SpeedNotHeld`).
    """
    measured, sent = _judge(objective, recordings, config, seed, task)
    segments, scores = measured.segments, measured.scores
    comparison = measured.comparison()

    def metric_of(name: str) -> Callable[[Comparison], float]:
        return lambda found: found.metrics[name]

    ci95 = measured.interval(_improvement, config, seed)
    metrics_ci95 = {name: measured.interval(metric_of(name), config, seed) for name in comparison.metrics}
    return HeadToHead(
        speed=measured.speed,
        unit=objective.unit,
        comparison=comparison,
        improvement_ci95=ci95,
        metrics_ci95=metrics_ci95,
        policy_segments=segments["policy"],
        reference_segments=segments["reference"],
        policy_scores=scores["policy"],
        reference_scores=scores["reference"],
        commanded=sent,
        every_second=_every_second(objective, recordings, config, task, measured, ci95, seed),
    )


def judged(
    objective: Objective,
    recordings: Sequence[Recording],
    config: EvaluationConfig,
    seed: int = 0,
    task: Task = VELOCITY,
) -> Comparison:
    """What `compare` finds, without any interval of it: for who asks whether the two can be compared at all.

    Its arguments are those of `compare`, and so is what it raises, in the same words.
    """
    return _judge(objective, recordings, config, seed, task)[0].comparison()


def _judge(
    objective: Objective, recordings: Sequence[Recording], config: EvaluationConfig, seed: int, task: Task
) -> tuple[_Measured, Commanded]:
    """What `compare` makes its numbers of, and what was commanded. Raises EvaluationError as it does."""
    sent = commanded({role: [r for r in recordings if r.role == role] for role in ROLES}, _one_speed(recordings, task))
    return _measure(objective, recordings, config, task, sent, seed), sent


def _every_second(
    objective: Objective,
    recordings: Sequence[Recording],
    config: EvaluationConfig,
    task: Task,
    counted: _Measured,
    ci95: tuple[float, float] | None,
    seed: int,
) -> EverySecond | None:
    """counted, ci95: what the valid segments gave, which are often all there are."""
    if not isinstance(task, FollowVelocity):
        return None
    try:
        every = _measure(objective, recordings, config.model_copy(update={"speed_tolerance": ANY_SPEED}), task)
        found = every.comparison()
        if any(len(every.segments[role]) > len(counted.segments[role]) for role in ROLES):
            ci95 = every.interval(_improvement, config, seed)
    except (HtsError, ArithmeticError, ValueError):  # a second at no speed has no cost of transport, say
        return None
    return EverySecond(found.improvement, ci95, *mean_speeds(every.segments["policy"], every.segments["reference"]))


def _improvement(comparison: Comparison) -> float:
    return comparison.improvement


def point(
    objective: Objective, recordings: Sequence[Recording], config: EvaluationConfig, task: Task = VELOCITY
) -> Comparison:
    """What `compare` finds, without intervals. Raises EvaluationError as it does; whether held speeds are apart is not
    looked at, since that takes more than a piece of a test."""
    return _measure(objective, recordings, config, task).comparison()


@dataclass(frozen=True)
class _Measured:
    """Valid segments and the objective's quantities of each, by role; names: of the quantities, in order."""

    objective: Objective
    speed: float
    segments: Mapping[str, Segments]
    scores: Mapping[str, Mapping[str, np.ndarray]]
    names: Sequence[str]

    def compared(self, policy: np.ndarray, reference: np.ndarray) -> Comparison:
        """Of two means, each (Q,)."""
        one, other = _named(self.names, policy), _named(self.names, reference)
        return compared(self.objective, one, other)

    def comparison(self) -> Comparison:
        """Of the means over the valid segments, every block and every session counting the same."""
        found = self.compared(*self._balance.means(*(_table(self.scores[role]) for role in ROLES)))
        check_finite(self.objective, found)
        return found

    def interval(
        self, number: Callable[[Comparison], float], config: EvaluationConfig, seed: int
    ) -> tuple[float, float] | None:
        """95 %, of a number of the comparison."""
        policy, reference = (_table(self.scores[role]) for role in ROLES)

        def drawn(one: np.ndarray, other: np.ndarray) -> float:
            try:
                return number(self.compared(one, other))
            except (EvaluationError, PluginError):  # the means themselves could be compared
                return math.nan

        return interval_of(drawn, self._balance, policy, reference, config.bootstrap, seed)

    @property
    def _balance(self) -> Balance:
        return Balance.of(*(self.segments[role] for role in ROLES))


def _measure(
    objective: Objective,
    recordings: Sequence[Recording],
    config: EvaluationConfig,
    task: Task,
    sent: Commanded | None = None,
    seed: int = 0,
) -> _Measured:
    """Cut the blocks of both roles and score their segments. Raises EvaluationError as `compare` does.

    sent: what was commanded; None: nothing is asked about held speeds. seed: of the interval of their difference.
    """
    speed = _one_speed(recordings, task)
    ordered = sorted(recordings, key=lambda recording: (recording.session, recording.block))
    found = (cut([r for r in ordered if r.role == role], config.speed_tolerance, task=task) for role in ROLES)
    segments = dict(zip(ROLES, in_common(*found), strict=True))
    if sent is not None:
        check_range(segments, speed, sent)  # the reason of all that follows from it
    for role in ROLES:
        _check_enough(segments, role, speed, config, task)
    if sent is not None:
        check_apart(segments, speed, sent, config, seed)
    scores = {role: scored(objective, segments[role], role) for role in ROLES}
    names = list(scores["policy"])
    if names != list(scores["reference"]):
        raise EvaluationError(
            f"Objective '{objective.name}' scores other quantities for the reference than for the policy."
        )
    return _Measured(objective, speed, segments, scores, names)


def by_speed(recordings: Sequence[Recording], task: Task = VELOCITY) -> dict[float, list[Recording]]:
    """Recordings of head-to-heads, grouped by the one speed (or set-point) each commands, slowest first."""
    groups: dict[float, list[Recording]] = {}
    for recording in recordings:
        groups.setdefault(_one_speed([recording], task), []).append(recording)
    return dict(sorted(groups.items()))


def _one_speed(recordings: Sequence[Recording], task: Task) -> float:
    speeds = sorted({command.commanded for recording in recordings for command in recording.schedule.commands})
    if len(speeds) != 1:
        found = ", ".join(f"{speed:g}" for speed in speeds) or "none"
        raise EvaluationError(
            f"A head-to-head compares two policies at one commanded speed; these {len(recordings)} recordings command "
            f"{found} {task.unit}."
        )
    return speeds[0]


def _enough(segments: Segments, config: EvaluationConfig) -> bool:
    return segments.valid >= config.min_valid and len(segments) >= config.min_segments


def _check_enough(both: Mapping[str, Segments], role: str, speed: float, config: EvaluationConfig, task: Task) -> None:
    segments, where, name = both[role], f"Head-to-head{task.at(speed)}", NAMES[role]
    if not segments.recordings:
        raise EvaluationError(f"{where}: no recording has the role '{role}'. Record {name} too.")
    if _enough(segments, config):
        return
    fell = f", with {segments.falls} falls" if segments.falls else ""
    fell += f", samples are missing in {segments.gaps}" if segments.gaps else ""
    if isinstance(task, FollowVelocity):
        walked = "" if math.isnan(segments.walked) else f"; it went {segments.walked:.2f} m/s on average"
        rule = f"within ±{config.speed_tolerance:.0%} of the commanded speed{fell}{walked}"
        remedy = "check that it walks and that base_velocity is right."
        if role == "reference" and not config.hold_speed and segments.walked > speed / 2:
            remedy += " If it simply goes another speed than it is told, have commands trimmed: evaluation.hold_speed."
    else:
        mean = "" if math.isnan(segments.walked) else f"; {task.quantity} {segments.walked:.3g} {task.unit} on average"
        rule = f"the task was done in them{fell}{mean}"
        remedy = f"check that it does its task and that {', '.join(task.channels)} are right."
    numbers, reference = refusal(segments, speed), both["reference"]
    if role != "reference" and reference.recordings and not _enough(reference, config):
        numbers["reference_walked"] = refusal(reference, speed)["walked"]
        remedy += f" {NAMES['reference'].capitalize()} has too few as well."
    raise TooFewSegments(
        f"{where}: {len(segments)} of {segments.total} segments of {name} are valid ({rule}); at least "
        f"{config.min_segments} and {config.min_valid:.0%} are needed. Nothing is reported: {remedy}",
        role,
        numbers,
    )


def _table(scores: Mapping[str, np.ndarray]) -> np.ndarray:
    """Columns of the quantities, shape (S, Q)."""
    return np.stack(list(scores.values()), axis=1)


def _named(names: Sequence[str], values: np.ndarray) -> dict[str, float]:
    return {name: float(value) for name, value in zip(names, values, strict=True)}
