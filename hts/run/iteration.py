"""What became of an iteration's candidates, from its stages' files.

Behind those that were trained stand, where these might not be tried, those closer to their anchors.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from hts.policy_ids import PRETRAINED
from hts.run.job import Job
from hts.training.sweep import iteration_of

CANDIDATES = ("scores", "objective_scores", "task_rewards", "falls", "tracked", "trials", "predicted")
"""What simulate.json holds for each candidate."""


def tuned(job: Job, iteration: int) -> dict[str, Any]:
    """finetune.json, with the candidates of nearer.json behind its own."""
    found, nearer = job.read("finetune", iteration), nearer_of(job, iteration)
    return {**found, "candidates": [*found["candidates"], *nearer["candidates"]]} if nearer else found


def simulated(job: Job, iteration: int) -> dict[str, Any]:
    """simulate.json, with the candidates of nearer.json and the elites among them."""
    found, nearer = job.read("simulate", iteration), nearer_of(job, iteration)
    if nearer is None:
        return found
    whole = judged_after(found, nearer["simulate"])
    if not job.read("gate", iteration)["elites"]:
        return whole
    left = [found.get("gave_up") or {}, nearer["simulate"]["gave_up"]]
    gave_up = {
        "elites": [name for one in left for name in one.get("elites") or ()],
        "line": next((one["line"] for one in left if one.get("line")), None),
    }
    return {**whole, "elites": [*found["elites"], *whole["elites"]], "gave_up": gave_up}


def judged_after(found: Mapping[str, Any], added: Mapping[str, Any]) -> dict[str, Any]:
    """Two looks as one: of all candidates, with the elites of the second one. Both: as simulate.json."""
    both = {key: {**found.get(key, {}), **added[key]} for key in CANDIDATES}
    steps = found["steps"] + added["steps"]
    return {**found, **both, "elites": added["elites"], "gave_up": added["gave_up"], "steps": steps}


def gated(job: Job, iteration: int) -> dict[str, Any] | None:
    """gate.json, with the candidates of nearer.json and who of all is tried; None of a run without a gate."""
    if not job.path("gate", iteration).exists():
        return None
    found, nearer = job.read("gate", iteration), nearer_of(job, iteration)
    if nearer is None:
        return found
    whole = tried_after(found, nearer["gate"])
    if found["elites"]:  # else who was proposed first is of no more account
        whole["proposed"] = [*found["proposed"], *whole["proposed"]]
    lines = [*found["lines"], nearer["line"], *nearer["gate"]["lines"]]
    return {**whole, "elites": nearer.get("elites", whole["elites"]), "lines": lines}


def tried_after(found: Mapping[str, Any], added: Mapping[str, Any]) -> dict[str, Any]:
    """Two tries as one: of all candidates, with who passed in the second one. Both: as gate.json."""
    return {
        **found,
        "proposed": added["proposed"],
        "kept_out": {**found["kept_out"], **added["kept_out"]},
        "policies": {**found["policies"], **added["policies"]},
        "pretrained": found["pretrained"] or added["pretrained"],
        "elites": added["elites"],
        "lines": [*found["lines"], *added["lines"]],
        "steps": found["steps"] + added["steps"],
    }


def nearer_of(job: Job, iteration: int) -> dict[str, Any] | None:
    """nearer.json; None where it was not needed."""
    return job.read("nearer", iteration) if job.path("nearer", iteration).exists() else None


def elites_of(job: Job, iteration: int) -> list[str]:
    """Who is tried for real: those that passed the gate; of a run without one, those that the selector chose."""
    return list((gated(job, iteration) or simulated(job, iteration))["elites"])


def gate_refused(job: Job, iteration: int) -> int:
    """How many candidates the gate refused."""
    found = gated(job, iteration)
    return 0 if found is None else sum(not row["passed"] for row in found["policies"].values())


def gate_note(job: Job, name: str) -> dict[str, Any] | None:
    """What the note beside a candidate says of it, from the stages' files, which are checked; None where the gate did
    not try it. name: of the run."""
    if name in (PRETRAINED, "best"):
        return None
    found = gated(job, iteration_of(name))
    row = None if found is None else found["policies"].get(name)
    if found is None or row is None:
        return None
    return {**{key: found[key] for key in ("instances", "set_points") if key in found}, **row}
