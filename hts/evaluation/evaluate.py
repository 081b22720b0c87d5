"""`hts evaluate`: a head-to-head of a run's policy against its pretrained one, once the run is over."""

from __future__ import annotations

import json
import shlex
import shutil
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hts.atomic import atomic_write
from hts.config_base import SEEDS
from hts.contracts import HoldSpeed, Robot, World
from hts.errors import ConfigError, EvaluationError, PolicyError, RunError
from hts.evaluation.asked import Check, asked, complete
from hts.evaluation.final import entry_and_scores, speeds_missed, task_entry
from hts.evaluation.held import ask_to_hold, check_held, hold_of
from hts.evaluation.walked_again import walked_again
from hts.locks import only_one
from hts.overrides import Override, parsed
from hts.parts import objectives_of, robot_of, world_of
from hts.policy_ids import PRETRAINED
from hts.recordings.store import RecordingStore
from hts.task_settings import check_speeds

if TYPE_CHECKING:
    from hts.config import RunConfig
    from hts.plugins import Registry
    from hts.recordings.recording import Recording

RESULT = "evaluation.json"
ITSELF = (
    "The best policy of this run is the pretrained one, so this compares it with itself: what is found is scatter. "
    "Name another one with --policy."
)
AS_BEFORE = (
    "No new log was read: all {count} recordings are those of an earlier evaluation. To walk it again, move the logs "
    "out of their bundle below {folder}, and give the command again."
)


def evaluate_run(
    folder: Path,
    speeds: Sequence[float] | None = None,
    policy: str | Path | None = None,
    world: str | None = None,
    seed: int | None = None,
    registry: Registry | None = None,
    sessions: int | None = None,
    overrides: Sequence[str | Override] = (),
    say: Callable[[str], None] | None = None,
) -> dict[str, Any]:
    """Head-to-head of a policy against the run's pretrained one, written to `folder`/evaluation.json and returned.

    speeds: m/s (or set-points of another task), by default those of the run's configuration; policy: "best" (default),
    "pretrained", a candidate's id or an ONNX file (at equal commands alone, if it was exported with the held ones in
    front: trimming it again would find nothing); world: a name, by default the run's own world with its settings;
    seed, sessions: by default the run's; sessions: how often it is done anew, and the interval is over them.
    overrides: KEY=VALUE each, of `evaluation.` and `world.` alone, laid over the run's settings for this once; the
    result says which. say: gets a line for each thing to know of the recordings, such as that a log ends early.
    Recordings are kept in `folder`/evaluation/data.zarr, apart from the run's data, those of a head-to-head that is
    refused (EvaluationError) too; nothing else is written then. Raises ConfigError for speeds, sessions or a seed that
    cannot be walked, RunError while another process evaluates the same run.
    """
    from hts.evaluation.other_settings import as_options, as_values, with_others
    from hts.plugins import load
    from hts.policies.held_commands import has_held_commands
    from hts.recordings.doubts import remarks
    from hts.recordings.needs import check_judged_by, check_recorded

    folder = Path(folder)
    registry = registry or load()
    others = parsed(overrides)
    config = with_others(folder, world, others, registry)
    laid_over = as_values(others)
    robot = robot_of(config, registry)
    task = robot.task()
    given = _given_speeds(speeds, config, robot)
    command = command_of(folder, given, policy, world, seed, sessions, as_options(laid_over))
    speeds = given or tuple(config.evaluation.speeds)
    seed = config.seed if seed is None else seed
    if not 0 <= seed < SEEDS:
        raise ConfigError(f"--seed: expected a whole number from 0 to {SEEDS - 1}, found {seed}.")
    count = config.evaluation.sessions if sessions is None else sessions
    if count < 1:
        raise ConfigError(f"--sessions: expected a whole number from 1 on, found {count}.")
    tested, reference = policy_file(folder, policy or "best"), policy_file(folder, PRETRAINED)
    objectives = objectives_of(config, registry)
    place = folder / "evaluation"
    hold = None if has_held_commands(Path(policy or "best")) else hold_of(config)
    if hold is not None:
        task.check_hold("evaluation.hold_speed")
        check_held("--speed", given, hold)
    place.mkdir(exist_ok=True)
    busy = f"{folder}: another evaluation of this run is being made. Wait for it, or stop it first."
    with only_one(place / ".lock", busy):
        where = world_of(config, registry, place, seed=seed, command=command)
        if say is not None and policy in (None, "best") and tested.read_bytes() == reference.read_bytes():
            say(ITSELF)

        def missed(recordings: Sequence[Recording]) -> list[float]:
            return speeds_missed(next(iter(objectives.values())), recordings, config.evaluation, seed, task)

        def check(recordings: Sequence[Recording]) -> None:
            check_recorded(objectives.values(), recordings)
            check_judged_by(recordings, robot)

        def walk(speeds: Sequence[float]) -> list[Recording]:
            return in_sessions(where, tested, reference, speeds, count, check)

        try:
            held, vain = _held(where, hold, config.evaluation.trims_again, speeds, walk, missed)
            recordings = walk(speeds)
        finally:
            where.close()
        walked = [*(held or ()), *vain, *recordings]
        if say is not None:
            for line in remarks(walked):
                say(line)
        store = RecordingStore(place / "data.zarr", create=True)
        known = {*store.ids()}
        ids = [store.write(recording) for recording in walked]
        if say is not None and not where.simulated and known.issuperset(ids):
            say(AS_BEFORE.format(count=len(ids), folder=place))
        entries, segments = {}, {}
        for name, objective in objectives.items():
            found = entry_and_scores(objective, held, recordings, config.evaluation, seed, task)
            entries[name], segments[name], _ = found
        result = {
            "world": config.world.name,
            "world_simulated": where.simulated,
            "world_identity": dict(where.identity()),
            "policy": str(policy or "best"),
            "seed": seed,
            "sessions": count,
            "settings": laid_over,
            "task": task_entry(task),
            "recordings": ids,
            "objectives": entries,
            "segments": segments,
        }
        _write(folder / RESULT, result)
    return result


def _given_speeds(speeds: Sequence[float] | None, config: RunConfig, robot: Robot) -> tuple[float, ...]:
    """Those that were asked for, none where the configuration says which. Raises ConfigError for what is no speed."""
    if isinstance(speeds, str) or not isinstance(speeds, Iterable | None):
        raise ConfigError(f"--speed: expected a list of numbers, found {speeds!r}.")
    given = () if speeds is None else tuple(speeds)
    robot.task().check(given, "--speed")
    check_speeds(given or config.evaluation.speeds, robot, "--speed" if given else "evaluation.speeds")
    twice = next((speed for speed in given if given.count(speed) > 1), None)
    if twice is not None:
        raise ConfigError(f"--speed: {twice:g} is there twice; ask for each once. --sessions 2 walks all of them anew.")
    return given


def _held(
    world: World,
    hold: HoldSpeed | None,
    again: int,
    speeds: Sequence[float],
    walk: Callable[[Sequence[float]], list[Recording]],
    missed: Callable[[Sequence[Recording]], list[float]],
) -> tuple[list[Recording] | None, list[Recording]]:
    """What was walked with the speed held, None where it is not, and in vain, see `walked_again`. Afterwards the world
    holds none."""
    if hold is None:
        return None, []

    def ask(hold: HoldSpeed, speeds: Sequence[float]) -> list[Recording]:
        ask_to_hold(world, hold)
        return walk(speeds)

    found = walked_again(ask(hold, speeds), hold, again, missed, ask)
    ask_to_hold(world, None)
    return found


def command_of(
    folder: Path,
    speeds: Sequence[float],
    policy: str | Path | None,
    world: str | None,
    seed: int | None,
    sessions: int | None,
    others: Sequence[str] = (),
) -> str:
    """What asks for the same evaluation again, quoted for a shell; what was left out stays left out.

    others: words of other settings.
    """
    given = {
        "policy": None if policy in (None, "best") else policy,
        "world": world,
        "seed": seed,
        "sessions": sessions,
    }
    words = ["hts", "evaluate", str(folder)]
    for speed in speeds:
        words += ["--speed", repr(float(speed))]
    for option, value in given.items():
        if value is not None:
            words += [f"--{option}", str(value)]
    words += others
    return shlex.join(words)


def in_sessions(
    world: World, policy: Path, reference: Path, speeds: Sequence[float], sessions: int, check: Check | None = None
) -> list[Recording]:
    """A head-to-head, or as many as asked for. check: as `complete` does it. Raises EvaluationError for a world that
    makes one only."""
    if sessions == 1:
        return complete(world, "head_to_head", asked(world, "head_to_head", policy, reference, speeds), speeds, check)
    found = asked(world, "head_to_head_sessions", policy, reference, speeds, sessions)
    if found is None:
        raise EvaluationError(
            f"World '{world.name}' makes a head-to-head once; {sessions} sessions were asked for. Ask for one."
        )
    return complete(world, "head_to_head_sessions", found, speeds, check)


def policy_file(folder: Path, policy: str | Path) -> Path:
    """An exported (ONNX) policy: "best", "pretrained", a candidate's id, or a file. Raises PolicyError.

    One that a run folder holds only as parameters (.safetensors), or such a file, is exported to `folder`/evaluation; a
    file by a name of its own, since those of two folders may be called the same.
    """
    from hts.policies.export_command import find_policy

    given = Path(policy)
    if given.suffix == ".onnx" and given.is_file():
        return _compared(given) if folder.resolve() in given.resolve().parents else given
    if given.suffix and not (given.suffix == ".safetensors" and given.is_file()):
        raise PolicyError(f"{policy}: expected a policy file that exists, ending in .onnx or .safetensors.")
    found = sorted((folder / "policies").glob("*.onnx")) + sorted((folder / "iterations").glob("**/*.onnx"))
    by_name = {file.stem: file for file in reversed(found)}  # policies/ wins over iterations/
    if str(policy) in by_name:
        return _compared(by_name[str(policy)])
    parameters = given if given.suffix else find_policy(folder, str(policy))

    from hts.policies.export import to_onnx
    from hts.policies.files import load_policy

    loaded = load_policy(parameters)
    name = parameters.stem if not given.suffix else f"{parameters.stem}-{loaded.card.policy_hash[:12]}"  # of any folder
    to = folder / "evaluation" / f"{name}.onnx"
    to.parent.mkdir(exist_ok=True)
    found_by_gate, beside = parameters.with_suffix(".gate.json"), to.with_suffix(".gate.json")
    if found_by_gate.exists():  # worlds that are machines ask for it
        shutil.copyfile(found_by_gate, beside)
    else:
        beside.unlink(missing_ok=True)
    return to_onnx(loaded, to)


def _compared(path: Path) -> Path:
    """The ONNX file of a run's policy. Raises PolicyError where it is not that of the parameters beside it."""
    from hts.policies.files import load_policy
    from hts.policies.onnx_ours import what_differs

    parameters = path.with_suffix(".safetensors")
    other = what_differs(path, load_policy(parameters)) if parameters.exists() else None
    if other is not None:
        raise PolicyError(
            f"{path}: damaged, or of another policy ({other}). Expected that of {parameters.name}. Delete it and give "
            "the command again: it is exported anew."
        )
    return path


def _write(path: Path, result: dict[str, Any]) -> None:
    try:
        atomic_write(path, json.dumps(result, indent=1, allow_nan=False) + "\n")
    except OSError as error:
        raise RunError(
            f"{path}: cannot be written ({error.strerror}). Make room or permission, then repeat."
        ) from error
