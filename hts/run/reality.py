"""The stages that happen in the world but for the tests of the elites and the final: first data, the best so far."""

from __future__ import annotations

from typing import Any

from hts.errors import PluginError
from hts.evaluation.asked import asked
from hts.evaluation.final import entry_of, judged_speeds
from hts.evaluation.held import ask_to_hold
from hts.evaluation.segments import falls_of
from hts.policy_ids import PRETRAINED
from hts.recordings.recording import Recording, robot_samples_of
from hts.run.head_to_head import head_to_head, held_head_to_head
from hts.run.job import Job
from hts.run.stages import Report


def collect(job: Job, report: Report) -> dict[str, Any]:
    """Roll the pretrained policy out under the schedule: D_0."""
    config = job.config.collection
    job.watch(report)
    exploring = job.save_exploring(config.exploration)
    policies = [job.exported(PRETRAINED)] * config.repeats + [exploring] * config.exploring
    recordings = asked(job.world, "collect", policies, job.schedule)
    if len(recordings) != len(policies):
        raise PluginError(
            f"World '{job.world.name}': collect() gave {len(recordings)} recordings for {len(policies)} policies; "
            "expected one for each, in order."
        )
    ids = job.keep(recordings, 0)
    falls = sum(falls_of(one.role, [one]) for one in recordings)
    if falls:
        job.say(
            f"The pretrained policy fell {falls} time{'' if falls == 1 else 's'} in the first data; {config.exploring} "
            f"of {len(policies)} recordings explore (collection.exploration={config.exploration:g})."
        )
    return {"recordings": ids, "samples": robot_samples_of(recordings), "falls": falls}


def best_so_far(job: Job, iteration: int, best: str, report: Report) -> dict[str, Any]:
    """The best so far against the pretrained policy as in a final of its own, with speeds walked again, for
    curves of saving over real samples. Nothing is kept of it but its numbers; `uncounted` is what the robot walked."""
    if best == PRETRAINED:
        return {"policy": best, "objectives": {}, "uncounted": 0}
    if iteration > 0:
        before = job.read("best", iteration - 1)
        if before["policy"] == best:
            return {**before, "uncounted": 0}
    job.watch(report)
    config, task = job.config.evaluation, job.robot.task()
    vain: list[Recording] = []
    if job.hold is not None:
        recordings, vain = held_head_to_head(job, best, job.hold)
        ask_to_hold(job.world, job.hold)  # as the next trials begin
    else:
        recordings = head_to_head(job, best)
    entries = {}
    for name, objective in job.objectives.items():
        results, refusals = judged_speeds(objective, recordings, config, job.seed("interval", "best", best), task)
        entries[name] = entry_of(objective, results)
        entries[name]["refused"] = {speed: str(why) for speed, why in refusals.items()}
    return {"policy": best, "objectives": entries, "uncounted": robot_samples_of([*recordings, *vain])}
