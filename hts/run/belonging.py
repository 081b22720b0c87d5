"""Whether the files of a run's stages belong together: each names candidates that the stages before it know.

One file may be whole by itself (`hts.run.stage_files`) and yet not be of this run, as after somebody edited it or put
back another one: then it names candidates that no other file knows, or it is of another policy of that name, since
candidates of all runs are called alike. The file that is at fault is named as a damaged one is.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from pathlib import Path
from typing import Any

from hts.policy_ids import PRETRAINED
from hts.run.iteration import tuned as tuned_in
from hts.run.job import Job
from hts.run.stage_files import gate_is_due
from hts.run.stages import damaged
from hts.training.sweep import is_nearer

JUDGED = ("objective_scores", "task_rewards", "predicted", "trials")
"""What simulate.json holds beside what every version wrote, and who is tried is chosen by."""


def check_fitted(job: Job, iteration: int) -> None:
    """Raise RunError for a fit.json that lacks an objective of the run."""
    _check_has(job.path("fit", iteration), job.objectives, job.read("fit", iteration))


def check_iteration(job: Job, iteration: int) -> None:
    """Raise RunError for a file of an iteration's stages, as far as they are done, that does not belong to the others.
    Its candidates are trained and judged."""
    rows, simulated = job.read("finetune", iteration)["candidates"], job.read("simulate", iteration)
    known = {row["id"]: str(row["policy_hash"]) for row in rows}
    _check_judged(job, iteration, known, simulated)
    tested = job.path("test", iteration)
    gate_is_next = gate_is_due(job.config, job.iteration_folder(iteration))
    if gate_is_next or not tested.exists():  # else nobody reads them any more, and a run of before has not all of them
        trusts = job.config.sweep.trust_region.enabled
        _check_has(
            job.path("simulate", iteration), JUDGED if gate_is_next else ("predicted",) if trusts else (), simulated
        )
    if job.path("gate", iteration).exists():
        _check_gate(job.path("gate", iteration), job.read("gate", iteration), known)
    nearer = job.path("nearer", iteration)
    if nearer.exists():
        found = job.read("nearer", iteration)
        closer = {row["id"]: str(row["policy_hash"]) for row in found["candidates"]}
        _check_has(nearer, closer, found["simulate"]["scores"])
        _check_scores(job, nearer, closer, found["simulate"])
        _check(nearer, "it judged", found["simulate"]["scores"], closer, "its candidates")
        _check_gate(nearer, found["gate"], closer)
        passed = [*job.read("gate", iteration)["elites"], *found["gate"]["elites"]]
        _check(nearer, "it lets pass", found.get("elites", ()), passed, "those that passed a gate")
        known |= closer
    if tested.exists():
        found = job.read("test", iteration)
        best = [] if found["best"] is None else [found["best"]]
        tried = [name for name in found["results"] if nearer.exists() or not is_nearer(name)]  # else they come again
        _check(tested, "it tried", tried, known, "candidates of this iteration")
        _check_has(tested, [*found["elites"], *best], found["results"])
        check_results(tested, found["results"], job.objectives)
        _check(tested, "the best so far is", [found["best_so_far"]], _tested(job, iteration + 1), "one that was tried")


def check_confirmed(job: Job) -> None:
    """Raise RunError for a confirm.json that names a policy which no iteration tried."""
    found = job.read("confirm")
    named = [found["best"], *found["tried"], *found["results"], *found.get("next", ())]
    _check(job.path("confirm"), "it names", named, _tested(job, job.done_iterations), "policies that were tried")
    _check_has(job.path("confirm"), found["tried"], found["results"])
    check_results(job.path("confirm"), found["results"], job.objectives)


def check_final(job: Job) -> None:
    """Raise RunError for a final.json of a policy that no iteration tried, or that lacks an objective of the run."""
    found, path = job.read("final"), job.path("final")
    _check(path, "it is of", [found["policy"]], _tested(job, job.done_iterations), "a policy that was tried")
    if found["objectives"]:  # else the policy to start from stays
        _check_has(path, job.objectives, found["objectives"])


def check_summary(job: Job) -> None:
    """Raise RunError for a summary.json of another run: with another seed, other candidates or another final."""
    found, path = job.read("summary"), job.path("summary")
    said = {"seed": found.get("seed"), "final.policy": (found.get("final") or {}).get("policy")}
    for key, expected in (("seed", job.config.seed), ("final.policy", job.read("final")["policy"])):
        if said[key] != expected:
            raise damaged(path, f"of another run: {key} is {said[key]}, expected {expected}")
    for index, row in enumerate(found["iterations"]):
        rows = tuned_in(job, index)["candidates"] if index < job.done_iterations else []
        trained = {one["id"]: one["kl"] for one in rows}
        for one in row.get("candidates", ()):
            name = str(one.get("id"))
            if name not in trained or one.get("kl") != trained[name]:
                raise damaged(path, f"of another run: its {name} is none of the candidates of iteration {index:02d}")


def _check_judged(job: Job, iteration: int, known: Mapping[str, str], simulated: Mapping[str, Any]) -> None:
    """Of finetune.json and simulate.json with other candidates, that one is at fault whose odd candidate has no policy
    file, for the stage that trained them wrote these."""
    tuned, judged = job.path("finetune", iteration), job.path("simulate", iteration)
    scores = simulated["scores"]
    odd = [name for name in known if name not in scores]
    if any(not job.policy_path(name).exists() for name in odd):
        _check(tuned, "its candidates are", known, scores, "those of simulate.json")
    for key in ("scores", "falls", "tracked"):
        _check_has(judged, known, simulated[key])
        _check(judged, f"its {key} are of", simulated[key], known, "the candidates of finetune.json")
    hashes = simulated.get("policy_hashes") or known
    for name, trained in known.items():
        if hashes.get(name) == trained:
            continue
        lies = job.policy_path(name)
        of_judged = lies.exists() and job.policy(name).card.policy_hash == hashes.get(name)
        path, other, expected = (tuned, trained, hashes[name]) if of_judged else (judged, hashes.get(name), trained)
        raise damaged(path, f"of another {name}, policy {str(other)[:12]}, expected {expected[:12]}")
    _check_scores(job, judged, known, simulated)
    _check(judged, "its elites are", simulated["elites"], known, "candidates of finetune.json")


def _check_scores(job: Job, path: Path, known: Iterable[str], simulated: Mapping[str, Any]) -> None:
    """Of scores in parts, which runs of before have not: of every candidate, in every objective."""
    scores = simulated.get("objective_scores")
    if scores is not None:
        _check_has(path, known, scores)
        for name, row in scores.items():
            _check_has(path, job.objectives, row, of=name)


def check_results(path: Path, results: Mapping[str, Mapping[str, Any]], objectives: Collection[str]) -> None:
    """Raise RunError for a trial that was not refused and yet says nothing of what it measured, in every objective."""
    for name, row in results.items():
        if row.get("tested") is not None and row["real"] is None:
            raise damaged(path, f"nothing about what was measured of {name}")
        for found in (row["real"], (row.get("tested") or {}).get("selection_score")):
            if found is not None:
                _check_has(path, objectives, found, of=name)


def _check_gate(path: Path, gate: Mapping[str, Any], known: Mapping[str, str]) -> None:
    """Whom the gate saw, kept out or let pass. known: id -> hash; results of before the gate kept it have none."""
    _check(path, "the gate saw", [*gate["policies"], *gate["kept_out"], *gate["proposed"]], known, "its candidates")
    _check(path, "the gate let pass", gate["elites"], gate["policies"], "those that it saw")
    for name, row in gate["policies"].items():
        if row.get("policy_hash", known[name]) != known[name]:
            raise damaged(path, f"the gate saw another {name}, {row['policy_hash'][:12]}, expected {known[name][:12]}")


def _tested(job: Job, iterations: int) -> set[str]:
    """Policies that have a trial in the first so many iterations, and those that need none."""
    tried = (job.read("test", index)["results"] for index in range(iterations))
    return {job.first, PRETRAINED, *(name for results in tried for name in results)}


def _check(path: Path, about: str, names: Iterable[str], known: Collection[str], expected: str) -> None:
    """Raise RunError if one of the names is not among those that are known."""
    strangers = sorted(name for name in names if name not in known)
    if strangers:
        listed = ", ".join(sorted(known)[:6]) or "nothing"
        raise damaged(path, f"{about} {strangers[0]}, expected {expected}: {listed}")


def _check_has(path: Path, wanted: Iterable[str], found: Collection[str], of: str = "") -> None:
    """Raise RunError if one of the names is missing; of: the candidate whose they are."""
    missing = sorted(name for name in wanted if name not in found)
    if missing:
        raise damaged(path, f"nothing about {', '.join(missing)}{of and f' of {of}'}")
