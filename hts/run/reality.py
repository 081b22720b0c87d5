"""The stages that happen in the world: first data, tests of the elites, the final head-to-head."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from hts.contracts import Comparison, TestedCandidate
from hts.evaluation.final import candidate_result, entry_of, head_to_heads, segment_scores
from hts.measurement import files
from hts.measurement.checks import check
from hts.run.job import Job
from hts.run.learning import model_path
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


def test(job: Job, iteration: int, best: str, report: Report) -> dict[str, Any]:
    """Elites against the pretrained policy; π_best <- the best of them, if it beats the best so far."""
    config = job.config
    name = f"iterations/{iteration:02d}"
    elites = job.read(f"{name}/simulate")["elites"]
    job.watch(report)
    speeds = (config.selection.speed,)
    sessions = job.world.head_to_heads([job.exported(elite) for elite in elites], job.exported("pretrained"), speeds)
    rows: dict[str, Any] = {}
    tested: list[TestedCandidate] = []
    ids: list[str] = []
    for elite, recordings in zip(elites, sessions, strict=True):
        ids += job.keep(recordings, iteration + 1)
        result = candidate_result(elite, job.objectives, recordings, config.evaluation, job.seed("interval", elite))
        rows[elite] = {"real": result.entry, "refused": result.refused}
        if result.tested is not None:
            tested.append(result.tested)
            rows[elite]["tested"] = {
                "fell": result.tested.fell,
                "selection_score": {key: value.selection_score for key, value in result.tested.comparisons.items()},
            }
    selector = job.registry.make_selector(config.selection.selector.name, config.selection.selector.settings)
    incumbent = _incumbent(job, iteration, best)
    return {
        "elites": elites, "results": rows, "recordings": ids, "best": selector.best(tested),
        # The protocol is the same in every iteration, so an earlier winner that measured better stays.
        "best_so_far": selector.best([*tested, *incumbent]) or best,
        "samples": sum(recording.num_samples for session in sessions for recording in session),
        "model_checks": _check_models(job, iteration, ids),
    }  # fmt: skip


test.__test__ = False  # type: ignore[attr-defined]  # not a pytest test


def _incumbent(job: Job, iteration: int, best: str) -> list[TestedCandidate]:
    """The best so far as it was measured in its own iteration; nobody before the first success."""
    if best == "pretrained":
        return []
    row = job.read(f"iterations/{best.split('-')[0]}/test")["results"][best]
    comparisons = {}
    for name, score in row["tested"]["selection_score"].items():
        (entry,) = row["real"][name].values()
        comparisons[name] = Comparison(entry["improvement"], score, entry["metrics"])
    return [TestedCandidate(best, comparisons, row["tested"]["fell"])]


def _check_models(job: Job, iteration: int, ids: list[str]) -> dict[str, Any]:
    """How well this iteration's models predicted the policies that were made with them: the hardest test."""
    if job.config.reward_source != "model":
        return {}
    tried = job.recordings(ids)
    known = job.recordings(job.known(iteration))
    return {
        name: check(objective, files.load(model_path(job, iteration, name)), tried, known)
        for name, objective in job.objectives.items()
    }


def final(job: Job, best: str, report: Report) -> dict[str, Any]:
    """The best policy against the pretrained one at every speed; also writes policies/best.*"""
    config = job.config
    job.save("best", job.policy(best))
    if best == "pretrained":
        return {"policy": best, "objectives": {}, "recordings": [], "samples": 0}
    job.watch(report)
    recordings = job.world.head_to_head(job.exported("best"), job.exported("pretrained"), config.evaluation.speeds)
    ids = job.keep(recordings, config.iterations + 1)
    entries, scores = {}, {}
    for name, objective in job.objectives.items():
        results = head_to_heads(objective, recordings, config.evaluation, job.seed("interval", "final"))
        entries[name], scores[name] = entry_of(objective, results), segment_scores(results)
    write_json(job.folder / "segments.json", scores)
    samples = sum(recording.num_samples for recording in recordings)
    return {"policy": best, "objectives": entries, "recordings": ids, "samples": samples}
