"""The stages that happen in the world but for the tests of the elites: first data, the final head-to-head."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from hts.evaluation.final import entry_of, segment_scores, walked_speeds
from hts.run.job import Job
from hts.run.stages import write_json

Report = Callable[[float], None]


def collect(job: Job, report: Report) -> dict[str, Any]:
    """Roll the pretrained policy out under the schedule: D_0."""
    config = job.config.collection
    job.watch(report)
    exploring = job.save_exploring("pretrained", config.exploration)
    policies = [job.exported("pretrained")] * config.repeats + [exploring] * config.exploring
    recordings = job.world.collect(policies, config.schedule)
    ids = job.keep(recordings, 0)
    return {"recordings": ids, "samples": sum(recording.num_samples for recording in recordings)}


def final(job: Job, best: str, report: Report) -> dict[str, Any]:
    """The best policy against the pretrained one at every speed; also writes policies/best.*"""
    config = job.config
    job.save("best", job.policy(best))
    if best == "pretrained":
        return {"policy": best, "objectives": {}, "recordings": [], "samples": 0}
    job.watch(report)
    recordings = job.world.head_to_head(job.exported("best"), job.exported("pretrained"), config.evaluation.speeds)
    ids = job.keep(recordings, config.iterations + 1)
    entries, scores, task = {}, {}, job.robot.task()
    for name, objective in job.objectives.items():
        results, refused = walked_speeds(objective, recordings, config.evaluation, job.seed("interval", "final"), task)
        entries[name], scores[name] = entry_of(objective, results), segment_scores(results)
        if refused:
            entries[name]["refused"] = refused
    write_json(job.folder / "segments.json", scores)
    samples = sum(recording.num_samples for recording in recordings)
    return {"policy": best, "objectives": entries, "recordings": ids, "samples": samples}
