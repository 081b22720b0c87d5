"""From recordings of head-to-heads to the entries of `summary.json`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from hts.config import EvaluationConfig
from hts.contracts import VELOCITY, FollowVelocity, Objective, Task, TestedCandidate
from hts.errors import EvaluationError
from hts.evaluation.across_speeds import mean_comparison
from hts.evaluation.head_to_head import HeadToHead, TooFewSegments, by_speed, compare, judged
from hts.evaluation.held import CommandAtLimit, NotComparable, SpeedNotHeld, refusal
from hts.evaluation.segments import Segments, falls_of

if TYPE_CHECKING:
    from hts.recordings.recording import Recording

Results = dict[float, HeadToHead]
REAL_KEYS = (
    *("improvement", "improvement_ci95", "segments", "valid", "falls", "mean_speed", "held", "commanded"),
    *("metrics", "metrics_ci95", "every_second"),
)


def speed_key(speed: float) -> str:
    """A commanded speed as a key of `summary.json`: 0.8 -> "0.8", 1 -> "1.0"."""
    return str(float(speed))


def head_to_heads(
    objective: Objective,
    recordings: Sequence[Recording],
    config: EvaluationConfig,
    seed: int = 0,
    task: Task = VELOCITY,
) -> Results:
    """One `HeadToHead` per commanded speed, slowest first. Raises EvaluationError as `compare` does."""
    groups = by_speed(recordings, task)
    return {speed: compare(objective, group, config, seed, task) for speed, group in groups.items()}


def walked_speeds(
    objective: Objective,
    recordings: Sequence[Recording],
    config: EvaluationConfig,
    seed: int = 0,
    task: Task = VELOCITY,
) -> tuple[Results, dict[str, NotComparable]]:
    """`judged_speeds`, where there is something to report.

    A run ends with what it measured: a policy chosen at one speed may walk too slowly at another, and so may the
    reference. Raises NotComparable if no speed is left: for what the policy did, where it did something.
    """
    results, refusals = judged_speeds(objective, recordings, config, seed, task)
    if refusals and not results:
        raise worst(refusals)
    return results, refusals


def worst(refusals: Mapping[str, NotComparable]) -> NotComparable:
    """Of why nothing could be compared at any speed, what is to be said: what the policy did before what the reference
    did."""
    return min(refusals.values(), key=lambda error: error.role == "reference")


def judged_speeds(
    objective: Objective,
    recordings: Sequence[Recording],
    config: EvaluationConfig,
    seed: int = 0,
    task: Task = VELOCITY,
) -> tuple[Results, dict[str, NotComparable]]:
    """Results of the speeds at which the two can be compared, and speed key -> why not at the others."""
    results: Results = {}
    refusals: dict[str, NotComparable] = {}
    for speed, group in by_speed(recordings, task).items():
        try:
            results[speed] = compare(objective, group, config, seed, task)
        except NotComparable as error:
            refusals[speed_key(speed)] = error
    return results, refusals


def entry_both_ways(
    objective: Objective,
    held: Sequence[Recording],
    open_loop: Sequence[Recording],
    config: EvaluationConfig,
    seed: int = 0,
    task: Task = VELOCITY,
) -> tuple[dict[str, Any], dict[str, Any], dict[str, NotComparable]]:
    """An objective's entry and `segment_scores` of a policy that was tried at held speed and at equal commands, and
    why held speeds were refused.

    The entry's `speeds` (and `refused`) are the held ones; `open_loop`: {"speeds", "refused"}, as the paper has them.
    `refused_falls`: how often it fell at speeds that are refused, where it did.
    A speed that cannot be judged in one way may be in the other. Raises NotComparable if there is none in either: for
    what the policy did, where it did something.
    """
    results, refusals = judged_speeds(objective, held, config, seed, task)
    beside, refusals_beside = judged_speeds(objective, open_loop, config, seed, task)
    if not results and not beside:
        raise worst(refusals)
    entry = entry_of(objective, results)
    entry["open_loop"] = {"speeds": entry_of(objective, beside)["speeds"]}
    for place, why, recordings in ((entry, refusals, held), (entry["open_loop"], refusals_beside, open_loop)):
        if why:
            place |= refused_and_fallen(why, recordings, task)
    return entry, segment_scores(results or beside), refusals


def entry_and_scores(
    objective: Objective,
    held: Sequence[Recording] | None,
    open_loop: Sequence[Recording],
    config: EvaluationConfig,
    seed: int,
    task: Task,
) -> tuple[dict[str, Any], dict[str, Any], dict[str, NotComparable]]:
    """As `entry_both_ways`; held: None where no speed was held, so that all there is was walked at equal commands."""
    if held is not None:
        return entry_both_ways(objective, held, open_loop, config, seed, task)
    results, refusals = walked_speeds(objective, open_loop, config, seed, task)
    refused = refused_and_fallen(refusals, open_loop, task) if refusals else {}
    return entry_of(objective, results) | refused, segment_scores(results), refusals


def refused_and_fallen(
    refused: Mapping[str, NotComparable], recordings: Sequence[Recording], task: Task
) -> dict[str, Any]:
    """`refused` of an entry: speed key -> why; `refused_falls`: how often the policy fell there, where it did."""
    fallen = {key: count for key, count in falls_by_speed(recordings, task).items() if key in refused}
    why = {key: str(error) for key, error in refused.items()}
    return {"refused": why, **({"refused_falls": fallen} if fallen else {})}


def entry_of(objective: Objective, results: Mapping[float, HeadToHead]) -> dict[str, Any]:
    """`final.objectives.<name>` of `summary.json`: {"unit", "metric_units", "speeds": {"0.8": {...}}}."""
    return {
        "unit": objective.unit,
        **({"metric_units": dict(objective.metric_units)} if objective.metric_units else {}),
        "speeds": {speed_key(speed): result.entry() for speed, result in sorted(results.items())},
    }


def speeds_missed(
    objective: Objective,
    recordings: Sequence[Recording],
    config: EvaluationConfig,
    seed: int = 0,
    task: Task = VELOCITY,
) -> list[float]:
    """Held speeds, m/s, slowest first, for which trimming did not find the commands: the policy and its reference ended
    apart, or too few seconds count because one of them went steadily faster or slower than was asked. Not those at
    which the policy fell: that is an answer, and a machine that fell does not try the same again."""
    found = []
    for speed, group in by_speed(recordings, task).items():
        if falls_of("policy", group):
            continue
        try:
            judged(objective, group, config, seed, task)
        except CommandAtLimit:
            continue
        except NotComparable as error:
            if isinstance(error, SpeedNotHeld) or _off(error, config.speed_tolerance):
                found.append(speed)
        except EvaluationError:  # for another reason, which trimming does not mend
            continue
    return found


def _off(error: NotComparable, tolerance: float) -> bool:
    """Whether who is refused went another speed than was asked: off on average by more than half of what a second may
    be. Who is nearer, and yet keeps the speed in too few seconds, wanders, which no command mends."""
    asked, walked = error.numbers.get("speed"), error.numbers.get("walked")
    return walked is not None and asked is not None and abs(walked - asked) > tolerance / 2 * abs(asked)


def segment_scores(results: Mapping[float, HeadToHead]) -> dict[str, Any]:
    """For `segments.json` (the distribution figure): speed -> role -> quantity -> one number a segment."""
    return {
        speed_key(speed): {
            "policy": {name: values.tolist() for name, values in result.policy_scores.items()},
            "reference": {name: values.tolist() for name, values in result.reference_scores.items()},
        }
        for speed, result in sorted(results.items())
    }


@dataclass(frozen=True)
class CandidateResult:
    """An elite after its head-to-head.

    entry: `real` of its candidate in `summary.json`, None if nothing could be reported;
    tested: for the selector, None likewise; refused: why, one line, or None; refusal: its numbers, as `TooFewSegments`,
    None where the reference is why; refused_falls: of who is refused, speed key -> how often it fell, where it did;
    reference: what was raised where the reference itself has too few valid segments.
    """

    entry: dict[str, Any] | None
    tested: TestedCandidate | None
    refused: str | None
    refusal: Mapping[str, float | None] | None = None
    refused_falls: Mapping[str, int] = field(default_factory=dict)
    reference: TooFewSegments | None = None


def candidate_result(
    candidate: str,
    objectives: Mapping[str, Objective],
    recordings: Sequence[Recording],
    config: EvaluationConfig,
    seed: int = 0,
    task: Task = VELOCITY,
    min_valid: float | None = None,
) -> CandidateResult:
    """Compare a candidate on every objective. A candidate that cannot walk is a result, not a failure of the run.

    The selector gets the mean over the speeds; who is refused at one speed is refused, and so is who met a reference
    that has too few valid segments itself (`reference`: what follows is the caller's to say). min_valid: share of valid
    segments that is asked of the candidate, where more than `config` asks of both.
    """
    entry: dict[str, Any] = {}
    comparisons = {}
    fell = False
    for name, objective in objectives.items():
        try:
            results = head_to_heads(objective, recordings, config, seed, task)
        except NotComparable as error:
            why, fallen = f"{candidate}: {error}", falls_by_speed(recordings, task)
            if error.role == "policy":
                return CandidateResult(None, None, why, error.numbers, fallen)
            few = error if isinstance(error, TooFewSegments) else None
            return CandidateResult(None, None, why, None, fallen, few)
        for speed, result in results.items():
            if min_valid is not None and result.valid < min_valid:
                why = unsteady(candidate, speed, result.policy_segments, min_valid, task)
                own = refusal(result.policy_segments, speed)
                return CandidateResult(None, None, why, own, falls_by_speed(recordings, task))
        entry[name] = {
            speed_key(speed): {key: result.entry()[key] for key in REAL_KEYS} for speed, result in results.items()
        }
        comparisons[name] = mean_comparison([result.comparison for result in results.values()])
        fell = fell or any(result.falls > 0 for result in results.values())
    return CandidateResult(entry, TestedCandidate(candidate, comparisons, fell), None)


def falls_by_speed(recordings: Sequence[Recording], task: Task) -> dict[str, int]:
    """Speed key -> how often the policy fell, where it did."""
    counts = {speed_key(speed): falls_of("policy", group) for speed, group in by_speed(recordings, task).items()}
    return {key: count for key, count in counts.items() if count}


def unsteady(candidate: str, speed: float, segments: Segments, min_valid: float, task: Task) -> str:
    """Why a candidate that could be compared is refused all the same, in one line."""
    return (
        f"{candidate}: Head-to-head{task.at(speed)}: {len(segments)} of {segments.total} segments of the policy are "
        f"valid, enough for a figure, but a trial asks for {min_valid:.0%} of them (selection.min_valid), since the "
        "next one may go worse."
    )


def task_entry(task: Task) -> dict[str, Any]:
    """`task` of `summary.json` and `evaluation.json`: how its set-points and what it achieves are called. `commanded`:
    whether anything is; if not, the one set-point, 0, is no number to show."""
    return {
        "velocity": isinstance(task, FollowVelocity),
        "quantity": task.quantity,
        "unit": task.unit,
        "commanded": task.set_points != (),
    }
