"""The stages that happen in the world but for the tests of the elites: first data, the final head-to-head."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

from hts.contracts import HoldSpeed
from hts.evaluation.final import (
    entry_both_ways,
    entry_of,
    judged_speeds,
    segment_scores,
    speeds_apart,
    walked_speeds,
)
from hts.evaluation.held import ask_to_hold
from hts.recordings.recording import Recording
from hts.run.job import Job
from hts.run.stages import read_json, write_json

Report = Callable[[float], None]

LONGEST = 4.0  # of the first trimming: what still moves the speed then is no noise that a longer one averages out


def collect(job: Job, report: Report) -> dict[str, Any]:
    """Roll the pretrained policy out under the schedule: D_0."""
    config = job.config.collection
    job.watch(report)
    exploring = job.save_exploring("pretrained", config.exploration)
    policies = [job.exported("pretrained")] * config.repeats + [exploring] * config.exploring
    recordings = job.world.collect(policies, job.schedule)
    ids = job.keep(recordings, 0)
    return {"recordings": ids, "samples": sum(recording.num_samples for recording in recordings)}


def final(job: Job, best: str, report: Report) -> dict[str, Any]:
    """The best policy against the pretrained one at every speed; also writes policies/best.*

    Where the run holds the speed it is done twice: held, and at equal commands as in the paper.
    """
    config = job.config
    job.save("best", job.policy(best))
    gate = job.exported(best).with_suffix(".gate.json")
    if gate.exists():
        job.note_gate("best", read_json(gate))
    if best == "pretrained":
        return {"policy": best, "objectives": {}, "recordings": [], "samples": 0}
    held: list[Recording] = []
    again: list[Recording] = []
    if job.hold is not None:
        job.watch(lambda share: report(share / 2))
        held, again = _held(job, job.hold)
        job.watch(lambda share: report((1 + share) / 2))
        ask_to_hold(job.world, None)  # the paper's figures beside: equal commands
    else:
        job.watch(report)
    recordings = _head_to_head(job)
    ids = job.keep([*held, *again, *recordings], config.iterations + 1)
    entries, scores, task = {}, {}, job.robot.task()
    for name, objective in job.objectives.items():
        seed = job.seed("interval", "final")
        if job.hold is not None:
            both = entry_both_ways(objective, held, recordings, config.evaluation, seed, task)
            entries[name], scores[name] = both
            continue
        results, refused = walked_speeds(objective, recordings, config.evaluation, seed, task)
        entries[name], scores[name] = entry_of(objective, results), segment_scores(results)
        if refused:
            entries[name]["refused"] = refused
    write_json(job.folder / "segments.json", scores)
    samples = sum(recording.robot_samples for recording in [*held, *again, *recordings])
    return {"policy": best, "objectives": entries, "recordings": ids, "samples": samples}


def best_so_far(job: Job, iteration: int, best: str, report: Report) -> dict[str, Any]:
    """The best so far against the pretrained policy as the final would have it, for curves of saving over real samples:
    nothing is kept of it but its numbers, and `uncounted` is what the robot walked."""
    if best == "pretrained":
        return {"policy": best, "objectives": {}, "uncounted": 0}
    if iteration > 0:
        before = job.read(f"iterations/{iteration - 1:02d}/best")
        if before["policy"] == best:
            return {**before, "uncounted": 0}
    job.watch(report)
    config, task = job.config.evaluation, job.robot.task()
    recordings = job.world.head_to_head(job.exported(best), job.exported("pretrained"), config.speeds)
    entries = {}
    for name, objective in job.objectives.items():
        results, refusals = judged_speeds(objective, recordings, config, job.seed("interval", "best", best), task)
        entries[name] = entry_of(objective, results)
        entries[name]["refused"] = {speed: str(why) for speed, why in refusals.items()}
    return {"policy": best, "objectives": entries, "uncounted": sum(one.robot_samples for one in recordings)}


def _held(job: Job, hold: HoldSpeed) -> tuple[list[Recording], list[Recording]]:
    """The head-to-head with the speed held; and what was recorded in vain.

    A speed at which the two ended apart is done again, trimmed twice as long each time, up to LONGEST times: whether a
    command was found well enough says nothing about what is saved with it.
    """
    config, task, objective = job.config.evaluation, job.robot.task(), next(iter(job.objectives.values()))
    ask_to_hold(job.world, hold)
    good, vain, longest = _head_to_head(job), [], LONGEST * hold.seconds
    for _ in range(config.trims_again):
        apart = speeds_apart(objective, good, config, job.seed("interval", "final"), task)
        if not apart:
            break
        hold = replace(hold, seconds=min(2 * hold.seconds, longest))
        ask_to_hold(job.world, hold)
        vain += [recording for recording in good if recording.schedule.commands[0].commanded in apart]
        kept = [recording for recording in good if recording.schedule.commands[0].commanded not in apart]
        good = [*kept, *_head_to_head(job, apart)]
    return good, vain


def _head_to_head(job: Job, speeds: Sequence[float] = ()) -> list[Recording]:
    """The best policy against the pretrained one, as the world does it now; speeds: none, all."""
    config = job.config.evaluation
    speeds, pair = speeds or config.speeds, (job.exported("best"), job.exported("pretrained"))
    if config.sessions > 1:
        found = job.world.head_to_head_sessions(*pair, speeds, config.sessions)
        if found is not None:
            return found
        job.stages.progress.say(
            f"World '{job.config.world.name}' makes a head-to-head once: one session, not {config.sessions}."
        )
    return job.world.head_to_head(*pair, speeds)
