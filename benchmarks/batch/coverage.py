"""Evaluations of frozen policies, again and again, and the truth of each: many processes side by side, resumable."""

from __future__ import annotations

import os
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from batch.coverage_lines import CoverageLine, Found, Lengths, Occasion, read_coverage
from batch.lines import append
from batch.methods import DEFAULT_REALITY, digest, reality_hash
from batch.queue import STOPPED
from hts import plugins
from hts.config import RunConfig
from hts.config_loading import load_config
from hts.contracts import Objective, WorldContext
from hts.errors import HtsError, PolicyError
from hts.evaluation.evaluate import in_sessions
from hts.evaluation.final import judged_speeds, speed_key
from hts.evaluation.head_to_head import HeadToHead
from hts.evaluation.held import ask_to_hold, hold_of
from hts.policies.deploy import DeployedPolicy
from hts.recordings.recording import Recording
from hts.worlds.realities.truth import Truth, truth
from hts.worlds.realities.workers import worker_processes


@dataclass(frozen=True)
class Work:
    """One line to be made. policy, reference: files; config: of the evaluation; repetition: None, the truth."""

    name: str
    policy: str
    policy_hash: str
    reference: str
    reference_hash: str
    reality: str
    reality_hash: str
    repetition: int | None
    lengths: Lengths
    commit: str
    config: RunConfig = field(repr=False)

    @property
    def objective(self) -> str:
        return next(iter(self.config.objectives))

    @property
    def key(self) -> str:
        """The same for the same policies, reality, objective, lengths, speeds, range of commands, repetition and
        commit; a truth is the same however long evaluations are."""
        evaluation = self.config.evaluation.model_dump(mode="json")
        if self.repetition is None:
            evaluation = {"speeds": evaluation["speeds"]}
        evaluation["commands"] = self.config.finetune.env.commands.vx
        what = [self.policy_hash, self.reference_hash, self.reality_hash, self.repetition, self.lengths.model_dump()]
        return digest([*what, self.config.objectives, evaluation, self.commit])[:16]


def policies_of(places: Sequence[Path]) -> dict[str, Path]:
    """Name -> ONNX file: files themselves, those of a folder, and of run folders (or folders of them) the best. Names
    are told apart by as many of their folders as it takes. Raises PolicyError where there is none."""
    found: dict[Path, tuple[Path, Path]] = {}  # the file wherever it is -> what it is called after, and itself
    for place in places:
        files = [place] if place.is_file() and place.suffix == ".onnx" else sorted(place.glob("*.onnx"))
        found |= {file.resolve(): (file.absolute().with_suffix(""), file) for file in files}
        if files:
            continue
        runs = [place, *sorted(one for one in place.glob("*") if one.is_dir())] if place.is_dir() else []
        best = {run: run / "policies" / "best.onnx" for run in runs if (run / "policies" / "best.onnx").is_file()}
        if not best:
            raise PolicyError(
                f"{place}: expected an .onnx file, a finished run's folder, or a folder of either. Export one with "
                "`hts export`, or keep folders of a batch with --keep."
            )
        found |= {file.resolve(): (run.absolute(), file) for run, file in best.items()}
    names = _told_apart([called for called, _ in found.values()])
    return {name: file for name, (_, file) in zip(names, found.values(), strict=True)}


def _told_apart(paths: Sequence[Path]) -> list[str]:
    """The last part of each path, and as many before it as no other path shares all of."""
    names, depth = [path.name for path in paths], 1
    while len(set(names)) < len(names) and depth < max(len(path.parts) for path in paths):
        depth, count = depth + 1, Counter(names)
        names = [
            "/".join(path.parts[-depth:]) if count[name] > 1 else name for path, name in zip(paths, names, strict=True)
        ]
    return names


def works_of(
    policies: dict[str, Path],
    reference: Path,
    realities: Sequence[str],
    repetitions: int,
    *,
    objective: str,
    robot: str,
    preset: str,
    settings: Sequence[str],
    evaluated: Lengths,
    true: Lengths,
    commit: str,
) -> list[Work]:
    """Truths first, then the repetitions in turn: stopped early, every pair has about equally many. Of files that hold
    one policy (runs in which nothing was found, say) the first counts."""
    config = load_config(preset=preset, objectives=[objective], robot=robot, world="twin", overrides=list(settings))
    changed = {"trim_seconds": evaluated.trimming, "hold_speed": True, "sessions": evaluated.sessions}
    config = config.model_copy(update={"evaluation": config.evaluation.model_copy(update=changed)})
    hashes: dict[str, str] = {}
    for name, path in policies.items():
        if (own := _hash(path)) not in hashes.values():
            hashes[name] = own
    machines = {name: reality_hash(name) for name in realities}
    return [
        Work(
            name,
            str(path.resolve()),
            hashes[name],
            str(reference.resolve()),
            _hash(reference),
            reality,
            machines[reality],
            repetition,
            true if repetition is None else evaluated,
            commit,
            config,
        )
        for repetition in (None, *range(repetitions))
        for reality in realities
        for name, path in policies.items()
        if name in hashes
    ]


def run_coverage(
    works: Sequence[Work],
    lines: Path,
    workers: int,
    *,
    stop_after: float | None = None,
    say: Callable[[str], None] = print,
    make: Callable[[Work], CoverageLine] | None = None,
) -> int:
    """Make the lines that are not there yet; 0, 1 if some could not be made, STOPPED if the time was up.

    Killed at any time, it goes on: a line is on the disk as soon as it is made.
    """
    made = {line.key for line in read_coverage([lines] if lines.exists() else [])}
    waiting = [work for work in works if work.key not in made]
    say(f"{len(works)} lines: {len(works) - len(waiting)} are there, {len(waiting)} to make, {workers} at once")
    begun, failed, total, done = time.monotonic(), 0, len(waiting), 0
    os.environ["OMP_NUM_THREADS"] = "1"  # of the processes that are started now: one core each
    with worker_processes(workers) as pool:
        running: dict[Future[CoverageLine], Work] = {}
        while waiting or running:
            late = stop_after is not None and time.monotonic() - begun > stop_after
            while waiting and len(running) < workers and not late:
                work = waiting.pop(0)
                running[pool.submit(make or made_line, work)] = work
            if not running:
                say(f"time is up: {len(waiting)} not begun; call again to go on")
                return STOPPED
            for future in wait(running, return_when=FIRST_COMPLETED).done:
                work, done = running.pop(future), done + 1
                what = f"[{done}/{total}] {work.name} on {work.reality}, " + (
                    "truth" if work.repetition is None else f"repetition {work.repetition}"
                )
                try:
                    line = future.result()
                except HtsError as error:
                    failed += 1
                    say(f"{what}: {error}")
                    continue
                append(lines, line)
                found = {key: round(one.improvement, 4) for key, one in line.speeds.items()}
                say(f"{what}: {line.seconds:.0f} s, {found}")
    return 1 if failed else 0


def made_line(work: Work) -> CoverageLine:
    """The evaluation or the truth."""
    started = time.monotonic()
    registry = plugins.load()
    name = work.objective
    objective = registry.make_objective(name, work.config.objectives[name])
    speeds, refused = _true(work) if work.repetition is None else _evaluated(work, objective, registry)
    return CoverageLine(
        kind="truth" if work.repetition is None else "evaluation",
        key=work.key,
        objective=name,
        unit=objective.unit,
        policy=work.name,
        policy_hash=work.policy_hash,
        reference_hash=work.reference_hash,
        reality=Path(work.reality).stem,
        reality_hash=work.reality_hash,
        repetition=work.repetition,
        lengths=work.lengths,
        commit=work.commit,
        speeds=speeds,
        refused=refused,
        seconds=round(time.monotonic() - started, 1),
    )


def _true(work: Work) -> tuple[dict[str, Found], dict[str, str]]:
    lengths, config = work.lengths, work.config
    found = truth(
        Truth(
            config.robot.name,
            work.objective,
            config.objectives[work.objective],
            work.policy,
            work.reference,
            work.reality,
            config.evaluation.speeds,
            lengths.sessions,
            lengths.warmup,
            lengths.trimming,
            lengths.block,
            config.finetune.env.commands.vx,
        )
    )
    known = Found.model_fields
    return {at: Found(**{key: one[key] for key in one if key in known}) for at, one in found["speeds"].items()}, {}


def _evaluated(work: Work, objective: Objective, registry: plugins.Registry) -> tuple[dict[str, Found], dict[str, str]]:
    """As `hts evaluate --sessions` does it, the speed held; and the same recordings taken in two other ways."""
    config, lengths = work.config, work.lengths
    seed = int(digest([work.policy_hash, work.repetition])[:7], 16)
    settings: dict[str, Any] = {"warmup_seconds": lengths.warmup, "block_seconds": lengths.block, "processes": 1}
    if work.reality != DEFAULT_REALITY:
        settings["reality"] = work.reality
    hold = hold_of(config)
    with tempfile.TemporaryDirectory() as folder:
        context = WorldContext(
            config.robot.name, config.robot.settings, config.objectives, seed, Path(folder), registry
        )
        world = registry.make_world("twin", settings, context)
        try:
            ask_to_hold(world, hold)
            given = (Path(work.policy), Path(work.reference), config.evaluation.speeds)
            recordings = in_sessions(world, *given, lengths.sessions)
        finally:
            world.close()
    results, refusals = judged_speeds(objective, recordings, config.evaluation, seed)
    pooled, _ = judged_speeds(objective, _as_one(recordings), config.evaluation, seed)
    alone: dict[str, list[Occasion]] = {}
    for session in dict.fromkeys(one.session for one in recordings):
        own, _ = judged_speeds(objective, [r for r in recordings if r.session == session], config.evaluation, seed)
        for speed, one in own.items():
            occasion = Occasion(improvement=one.improvement, improvement_ci95=one.improvement_ci95)
            alone.setdefault(speed_key(speed), []).append(occasion)
    speeds = {
        speed_key(speed): Found(
            improvement=one.improvement,
            improvement_ci95=one.improvement_ci95,
            as_one=pooled[speed].improvement_ci95 if speed in pooled else None,
            every_second=_every_second(one),
            occasions=alone.get(speed_key(speed), []),
            mean_speed=one.mean_speed,
            reference_speed=one.reference_mean_speed,
            falls=one.falls,
        )
        for speed, one in results.items()
    }
    return speeds, {key: str(error) for key, error in refusals.items()}


def _every_second(result: HeadToHead) -> Occasion | None:
    every = result.every_second
    return None if every is None else Occasion(improvement=every.improvement, improvement_ci95=every.improvement_ci95)


def _as_one(recordings: Sequence[Recording]) -> list[Recording]:
    """The same blocks, all of one session at each speed: how intervals were made before sessions were units."""
    names = list(dict.fromkeys(one.session for one in recordings))
    blocks = 1 + max(one.block for one in recordings)
    return [one.replace(session="one", block=blocks * names.index(one.session) + one.block) for one in recordings]


def _hash(path: Path) -> str:
    try:
        return DeployedPolicy(path).card.policy_hash
    except HtsError as error:
        raise PolicyError(f"{path}: {error}") from error
