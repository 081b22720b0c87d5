"""Which policies nothing else beats in all objectives at once: measured in all iterations, and simulated in one."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from hts.policy_ids import PRETRAINED
from hts.run.iteration import simulated as judged
from hts.run.job import Job
from hts.run.stages import number
from hts.selection.fronts import non_dominated


@dataclass(frozen=True)
class Measured:
    """A policy with its measured gains over the pretrained one (selection scores, in the order of the objectives).

    iteration: in which it was tested; real: its entry of `summary.json`. The pretrained policy has neither.
    """

    id: str
    gains: tuple[float, ...]
    iteration: int | None = None
    real: Mapping[str, Any] | None = None


def tested_policies(job: Job, iterations: int) -> list[Measured]:
    """All that were tested in the first so many iterations, did not fall, and have a score in every objective."""
    found = []
    for index in range(iterations):
        for name, row in job.read("test", index)["results"].items():
            tested = row.get("tested")
            if not tested or tested["fell"]:
                continue
            gains = tuple(number(tested["selection_score"].get(objective)) for objective in job.objectives)
            found.append(Measured(name, gains, index, row["real"]))
    return found


def real_front(job: Job, iterations: int, without: Collection[str] = ()) -> list[Measured]:
    """The undominated ones among them and the pretrained policy, whose gain is 0 in every objective; never empty.

    without: ids of policies that may not be on it, since they fell afterwards.
    """
    tested = [policy for policy in tested_policies(job, iterations) if policy.id not in without]
    policies = [Measured(PRETRAINED, (0.0,) * len(job.objectives)), *tested]
    return [policies[index] for index in non_dominated([policy.gains for policy in policies])]


def simulated_front(objectives: Sequence[str], simulated: Mapping[str, Any]) -> list[str]:
    """Ids of the undominated candidates of an iteration, from its simulate.json: by mean r_real of each objective,
    among those that keep the speed and never fell, and the pretrained policy."""
    scores = simulated.get("objective_scores") or {}
    walking = [name for name in simulated["scores"] if simulated["tracked"][name] and not simulated["falls"][name]]
    names = [name for name in (PRETRAINED, *walking) if name in scores]
    points = [tuple(number(scores[name].get(objective)) for objective in objectives) for name in names]
    return [names[index] for index in non_dominated(points)]


def front_entry(job: Job, without: Collection[str]) -> dict[str, Any]:
    """`front` of `summary.json`; without: as in `real_front`."""
    objectives = list(job.objectives)
    iterations = range(job.done_iterations)
    simulated = {index: judged(job, index) for index in iterations}
    return {
        "units": {name: objective.unit for name, objective in job.objectives.items()},
        "simulation": [{"iteration": i, "ids": simulated_front(objectives, simulated[i])} for i in iterations],
        "real": [_entry(policy, objectives) for policy in real_front(job, len(iterations), without)],
    }


def _entry(policy: Measured, objectives: Sequence[str]) -> dict[str, Any]:
    """id, iteration and, per objective, improvement with its interval and what the policy was selected by."""
    improvements = {}
    for name, gain in zip(objectives, policy.gains, strict=True):
        speeds = list(policy.real[name].values()) if policy.real else [{"improvement": 0.0}]
        improvements[name] = {
            "improvement": sum(one["improvement"] for one in speeds) / len(speeds),  # the selector's own mean
            # Each speed has an interval of its own; of several there is none to show for their mean.
            "improvement_ci95": speeds[0].get("improvement_ci95") if len(speeds) == 1 else None,
            "selection_score": gain,
        }
    return {"id": policy.id, "iteration": policy.iteration, "improvements": improvements}
