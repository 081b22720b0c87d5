"""From recordings of head-to-heads to the entries of `summary.json`, and `hts evaluate`."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hts.atomic import atomic_write
from hts.config import EvaluationConfig, Named
from hts.contracts import VELOCITY, FollowVelocity, Objective, Task, TestedCandidate, World, WorldContext
from hts.errors import EvaluationError, PolicyError, RunError
from hts.evaluation.across_speeds import mean_comparison
from hts.evaluation.head_to_head import HeadToHead, TooFewSegments, by_speed, compare
from hts.evaluation.held import CommandAtLimit, NotComparable, SpeedNotHeld, ask_to_hold, hold_of, refusal
from hts.evaluation.segments import Segments

if TYPE_CHECKING:
    from hts.plugins import Registry
    from hts.recordings.recording import Recording

RESULT = "evaluation.json"

Results = dict[float, HeadToHead]
REAL_KEYS = (
    *("improvement", "improvement_ci95", "segments", "valid", "falls", "mean_speed", "held", "commanded"),
    *("metrics", "metrics_ci95"),
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
) -> tuple[Results, dict[str, str]]:
    """`head_to_heads`, but a speed that the policy does not keep is refused alone: results, and speed key -> why.

    A run ends with what it measured: a policy chosen at one speed may walk too slowly at another. Raises
    EvaluationError if no speed is left, or if the reference itself cannot be judged.
    """
    results, refusals = judged_speeds(objective, recordings, config, seed, task)
    for error in refusals.values():
        if error.role == "reference":
            raise error
    if refusals and not results:
        raise list(refusals.values())[-1]
    return results, {key: str(error) for key, error in refusals.items()}


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
    A speed that cannot be judged in one way may be in the other. Raises EvaluationError if there is none in either.
    """
    results, refusals = judged_speeds(objective, held, config, seed, task)
    beside, refusals_beside = judged_speeds(objective, open_loop, config, seed, task)
    if not results and not beside:
        raise next(iter(refusals.values()))
    entry = entry_of(objective, results)
    entry["open_loop"] = {"speeds": entry_of(objective, beside)["speeds"]}
    for place, why in ((entry, refusals), (entry["open_loop"], refusals_beside)):
        if why:
            place["refused"] = {key: str(error) for key, error in why.items()}
        fallen = {key: int(error.numbers.get("falls") or 0) for key, error in why.items()}
        if any(fallen.values()):
            place["refused_falls"] = {key: count for key, count in fallen.items() if count}
    return entry, segment_scores(results or beside), refusals


def entry_of(objective: Objective, results: Mapping[float, HeadToHead]) -> dict[str, Any]:
    """`final.objectives.<name>` of `summary.json`: {"unit", "speeds": {"0.8": {...}}}."""
    return {
        "unit": objective.unit,
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
    apart, or too few seconds count because one of them went steadily faster or slower than was asked."""
    found = []
    for speed, group in by_speed(recordings, task).items():
        try:
            compare(objective, group, config, seed, task)
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
    tested: for the selector, None likewise; refused: why, one line, or None; refusal: its numbers, as `TooFewSegments`.
    """

    entry: dict[str, Any] | None
    tested: TestedCandidate | None
    refused: str | None
    refusal: Mapping[str, float | None] | None = None


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

    The selector gets the mean over the speeds; who is refused at one speed is refused. A reference that has too few
    valid segments itself does stop the run: then nothing can be compared. min_valid: share of valid segments that is
    asked of the candidate, where more than `config` asks of both.
    """
    entry: dict[str, Any] = {}
    comparisons = {}
    fell = False
    for name, objective in objectives.items():
        try:
            results = head_to_heads(objective, recordings, config, seed, task)
        except NotComparable as error:
            if error.role == "reference" and isinstance(error, TooFewSegments):
                raise
            return CandidateResult(None, None, f"{candidate}: {error}", error.numbers)
        for speed, result in results.items():
            if min_valid is not None and result.valid < min_valid:
                why = unsteady(candidate, speed, result.policy_segments, min_valid, task)
                return CandidateResult(None, None, why, refusal(result.policy_segments, speed))
        entry[name] = {
            speed_key(speed): {key: result.entry()[key] for key in REAL_KEYS} for speed, result in results.items()
        }
        comparisons[name] = mean_comparison([result.comparison for result in results.values()])
        fell = fell or any(result.falls > 0 for result in results.values())
    return CandidateResult(entry, TestedCandidate(candidate, comparisons, fell), None)


def unsteady(candidate: str, speed: float, segments: Segments, min_valid: float, task: Task) -> str:
    """Why a candidate that could be compared is refused all the same, in one line."""
    return (
        f"{candidate}: Head-to-head{task.at(speed)}: {len(segments)} of {segments.total} segments of the policy are "
        f"valid, enough for a figure, but a trial asks for {min_valid:.0%} of them (selection.min_valid), since the "
        "next one may go worse."
    )


def evaluate_run(
    folder: Path,
    speeds: Sequence[float] | None = None,
    policy: str | Path | None = None,
    world: str | None = None,
    seed: int | None = None,
    registry: Registry | None = None,
    sessions: int | None = None,
) -> dict[str, Any]:
    """Head-to-head of a policy against the run's pretrained one, written to `folder`/evaluation.json and returned.

    speeds: m/s (or set-points of another task), by default those of the run's configuration; policy: "best" (default),
    "pretrained", a candidate's id or an ONNX file; world: a name, by default the run's own world with its settings;
    seed, sessions: by default the run's; sessions: how often it is done anew, and the interval is over them.
    Recordings are kept in `folder`/evaluation/data.zarr, apart from the run's data. Nothing is written if the
    head-to-head is refused (EvaluationError).
    """
    from hts.config_loading import read_config
    from hts.plugins import load
    from hts.recordings.store import RecordingStore

    folder = Path(folder)
    config = read_config(folder / "config.yaml")
    registry = registry or load()
    task = registry.make_robot(config.robot.name, config.robot.settings).task()
    task.check(speeds or (), "--speed")
    speeds = tuple(speeds or config.evaluation.speeds)
    seed = config.seed if seed is None else seed
    count = sessions or config.evaluation.sessions
    tested, reference = policy_file(folder, policy or "best"), policy_file(folder, "pretrained")
    objectives = {name: registry.make_objective(name, settings) for name, settings in config.objectives.items()}
    named = config.world if world in (None, config.world.name) else Named(name=str(world))
    place = folder / "evaluation"
    context = WorldContext(
        robot=config.robot.name,
        robot_settings=config.robot.settings,
        objectives=config.objectives,
        seed=seed,
        folder=place,
        registry=registry,
    )
    place.mkdir(exist_ok=True)
    where = registry.make_world(named.name, named.settings, context)
    hold = hold_of(config)
    if hold is not None:
        task.check_hold("evaluation.hold_speed")
    held: list[Recording] = []
    try:
        if hold is not None:
            ask_to_hold(where, hold)
            held = in_sessions(where, tested, reference, speeds, count)
            ask_to_hold(where, None)
        recordings = in_sessions(where, tested, reference, speeds, count)
    finally:
        where.close()
    store = RecordingStore(place / "data.zarr", create=True)
    ids = [store.write(recording) for recording in [*held, *recordings]]
    entries, segments = {}, {}
    for name, objective in objectives.items():
        if hold is not None:
            both = entry_both_ways(objective, held, recordings, config.evaluation, seed, task)
            entries[name], segments[name], _ = both
        else:
            found = head_to_heads(objective, recordings, config.evaluation, seed, task)
            entries[name], segments[name] = entry_of(objective, found), segment_scores(found)
    result = {
        "world": named.name,
        "world_simulated": where.simulated,
        "policy": str(policy or "best"),
        "seed": seed,
        "sessions": count,
        "task": task_entry(task),
        "recordings": ids,
        "objectives": entries,
        "segments": segments,
    }
    _write(folder / RESULT, result)
    return result


def in_sessions(world: World, policy: Path, reference: Path, speeds: Sequence[float], sessions: int) -> list[Recording]:
    """A head-to-head, or as many as asked for. Raises EvaluationError for a world that makes one only."""
    if sessions == 1:
        return world.head_to_head(policy, reference, speeds)
    found = world.head_to_head_sessions(policy, reference, speeds, sessions)
    if found is None:
        raise EvaluationError(
            f"World '{world.name}' makes a head-to-head once; {sessions} sessions were asked for. Ask for one."
        )
    return found


def task_entry(task: Task) -> dict[str, Any]:
    """`task` of `summary.json` and `evaluation.json`: how its set-points and what it achieves are called. `commanded`:
    whether anything is; if not, the one set-point, 0, is no number to show."""
    return {
        "velocity": isinstance(task, FollowVelocity),
        "quantity": task.quantity,
        "unit": task.unit,
        "commanded": task.set_points != (),
    }


def policy_file(folder: Path, policy: str | Path) -> Path:
    """An exported (ONNX) policy: "best", "pretrained", a candidate's id, or a file. Raises PolicyError.

    One that a run folder holds only as parameters (.safetensors), or such a file, is exported to `folder`/evaluation.
    """
    from hts.policies.export_command import find_policy

    given = Path(policy)
    if given.suffix == ".onnx" and given.is_file():
        return given
    if given.suffix and not (given.suffix == ".safetensors" and given.is_file()):
        raise PolicyError(f"{policy}: expected a policy file that exists, ending in .onnx or .safetensors.")
    found = sorted((folder / "policies").glob("*.onnx")) + sorted((folder / "iterations").glob("**/*.onnx"))
    by_name = {file.stem: file for file in reversed(found)}  # policies/ wins over iterations/
    if str(policy) in by_name:
        return by_name[str(policy)]
    parameters = given if given.suffix else find_policy(folder, str(policy))

    from hts.policies.export import to_onnx
    from hts.policies.files import load_policy

    to = folder / "evaluation" / f"{parameters.stem}.onnx"
    to.parent.mkdir(exist_ok=True)
    return to_onnx(load_policy(parameters), to)


def _write(path: Path, result: dict[str, Any]) -> None:
    try:
        atomic_write(path, json.dumps(result, indent=1, allow_nan=False) + "\n")
    except OSError as error:
        raise RunError(
            f"{path}: cannot be written ({error.strerror}). Make room or permission, then repeat."
        ) from error
