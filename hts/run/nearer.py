"""The stage `nearer`: candidates of an iteration that may not be tried, once more, closer to their anchors.

Where nobody may be tried; with `gate.nearer_for: first` also where the one may not whom the selector would name first.

A training that went too far is not worth nothing: on the straight line of parameters back to the anchor, which may be
tried, falls and end stops become rarer, and some of the gain is left. As in training, where a candidate that ended
beyond its KL bound is brought back along the same line (`hts.rl.kl_bound.project_to_kl_bound`).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import torch

from hts.config import RunConfig
from hts.config_base import percent
from hts.contracts import SimulatedCandidate
from hts.policies.files import Policy, make_card
from hts.run.gate import as_judged, tried
from hts.run.iteration import gated, judged_after, tried_after
from hts.run.job import Job
from hts.run.judging import judge, needed, same_policies
from hts.run.stages import Report
from hts.training.sweep import is_nearer, nearer_id


def may_go_nearer(config: RunConfig) -> bool:
    """Whether a run may have this stage at all."""
    return config.gate.enabled and bool(config.gate.nearer)


def is_due(job: Job, iteration: int) -> bool:
    """Whether an iteration has this stage and lacks its result: nobody may be tried, or not the first, though somebody
    was trained to the end. Of an iteration that was tested already: whether somebody of this stage was."""
    if job.path("nearer", iteration).exists():
        return False
    if job.path("test", iteration).exists():  # its result was deleted since, or a run of before never had one
        return any(is_nearer(name) for name in job.read("test", iteration)["elites"])
    found, rows = gated(job, iteration), _trained(job, iteration)
    if found is None or not found["strict"] or not rows:
        return False
    barred = barred_by(found)
    if all(row["id"] in barred for row in rows):
        return True
    return job.config.gate.nearer_for == "first" and _first(job, iteration, rows) in barred


def barred_by(gated: Mapping[str, Any]) -> set[str]:
    """Who may not be tried: kept out before the gate, or refused by it. gated: as gate.json."""
    return {*gated["kept_out"], *(name for name, row in gated["policies"].items() if not row["passed"])}


def _first(job: Job, iteration: int, rows: Sequence[Mapping[str, Any]]) -> str | None:
    """Whom the selector would name first of them if nobody had fallen; None if nobody. rows: of finetune.json."""
    simulated, alike = job.read("simulate", iteration), same_policies(rows)
    able = [dataclasses.replace(as_judged(row, simulated), falls=0) for row in rows if row["id"] not in alike]
    return next(iter(job.selector().elites(able, 1)), None)


def nearer(job: Job, iteration: int, best: str, report: Report) -> dict[str, Any]:
    """Judge candidates at shares of the way from their anchors, the largest first, and try them at the gate, until
    somebody passes; policies beside the others.

    The result holds them as finetune.json, simulate.json and gate.json do, and who is tried: of those that pass here
    and those that passed before whom the selector names.
    """
    shares = sorted(job.config.gate.nearer, reverse=True)
    told = ", then ".join(f"{percent(one)} %" for one in shares)
    before = gated(job, iteration)
    assert before is not None  # else it is not due
    rest = [row for row in _trained(job, iteration) if row["id"] in barred_by(before)]
    if before["elites"]:
        names = " and ".join(row["id"] for row in rest)
        whom, whose = ("it is", "its anchor") if len(rest) == 1 else ("they are", "their anchors")
        line = f"{names} may not be tried, so {whom} judged at {told} of the way from {whose}"
    else:
        line = (
            f"nobody of this iteration may be tried, so candidates are judged at {told} of the way from their anchors"
        )
    job.say(f"iteration {iteration:02d}: {line}")
    tuned = job.read("finetune", iteration)
    yardstick = before["pretrained"]
    rows: list[dict[str, Any]] = []
    whole: dict[str, Any] = {}
    for number, share in enumerate(shares):  # one at a time: no more policies at once than the stage `simulate` had
        looked = _looked(job, iteration, tuned, rest, best, share)
        rows += looked["candidates"]
        report((number + 0.5) / len(shares))
        found = tried(
            job,
            iteration,
            looked["candidates"],
            looked["simulate"],
            lambda part, number=number: report((number + 0.5 + part / 2) / len(shares)),  # type: ignore[misc]
            again=bool(before["elites"]) or number + 1 < len(shares),
            yardstick=yardstick,
        )
        yardstick = yardstick or found["pretrained"]
        whole = {
            "simulate": judged_after(whole["simulate"], looked["simulate"]) if whole else looked["simulate"],
            "gate": tried_after(whole["gate"], found) if whole else found,
        }
        if found["elites"]:
            passed = f"{' and '.join(found['elites'])} passed the gate, at {percent(share)} % of the way"
            job.say(f"iteration {iteration:02d}: {passed}")
            whole["gate"]["lines"] = [*whole["gate"]["lines"], passed]
            break
    elites = whole["gate"]["elites"]
    if before["elites"]:
        elites = _of_both(job, iteration, before["elites"], rows, whole)
    return {"line": line, "candidates": rows, **whole, "elites": elites}


def _of_both(
    job: Job, iteration: int, passed: Sequence[str], rows: Sequence[Mapping[str, Any]], whole: Mapping[str, Any]
) -> list[str]:
    """Whom the selector names of those that passed as they were trained and of those that pass closer to their anchors,
    the latter in rows and whole, as `nearer` returns them. All were judged in the same worlds."""
    trained, simulated = job.read("finetune", iteration)["candidates"], job.read("simulate", iteration)
    able = [as_judged(row, simulated) for row in trained if row["id"] in passed]
    able += [as_judged(row, whole["simulate"]) for row in rows if row["id"] in whole["gate"]["elites"]]
    trials = {**simulated["trials"], **whole["simulate"]["trials"]}
    able = by_one_measure(able, job.config.simulation_test.min_valid, [*trained, *rows], trials)
    return job.selector().elites(able, job.elites(iteration))


def by_one_measure(
    able: Sequence[SimulatedCandidate],
    least: float,
    rows: Sequence[Mapping[str, Any]],
    trials: Mapping[str, Sequence[Mapping[str, Any]]],
) -> list[SimulatedCandidate]:
    """Who was judged in two parts, each by the steadiest of its own where nobody in it did the task in enough of its
    seconds, held to one share: that of all. least: `simulation_test.min_valid`; rows: of all that were judged; trials:
    theirs, as simulate.json has them."""
    reached = {row["id"]: min(trial["valid"] for trial in trials[row["id"]]) for row in rows}
    share = needed(least, rows, reached)
    return [dataclasses.replace(one, tracked=one.tracked and reached[one.id] >= share) for one in able]


def _trained(job: Job, iteration: int) -> list[dict[str, Any]]:
    """Rows of finetune.json that a training ended with; not those that were there before it."""
    before = {row["id"] for row in job.untrained(iteration)}
    rows = job.read("finetune", iteration)["candidates"]
    return [row for row in rows if row["stopped"] is None and row["id"] not in before]


def _looked(
    job: Job,
    iteration: int,
    tuned: Mapping[str, Any],
    trained: Sequence[Mapping[str, Any]],
    best: str,
    share: float,
) -> dict[str, Any]:
    """The candidates of one share: their rows, and how they were judged. tuned: finetune.json; trained: its rows of
    those that are looked at once more."""
    rows, anchors = [], []
    for row in trained:
        anchor = job.anchor(best if row["anchor"] == "best" else row["anchor"])
        rows.append(_saved(job, row, anchor, share))
        anchors.append(anchor)
    judged = judge(job, iteration, tuned, rows, anchors)
    distances = judged.pop("kl")
    for row in rows:
        row["kl"] = distances[row["id"]]
        policy = job.policy(row["id"])
        made = {**policy.card.made, "kl": row["kl"]}
        job.save(row["id"], dataclasses.replace(policy, card=dataclasses.replace(policy.card, made=made)))
    return {"candidates": rows, "simulate": judged}


def _saved(job: Job, row: Mapping[str, Any], anchor: Policy, share: float) -> dict[str, Any]:
    """A candidate at a share of the way from its anchor: written, and its row. Its kl is not known yet."""
    end = job.policy(row["id"])
    tensors = {name: torch.lerp(anchor.tensors[name], value, share) for name, value in end.tensors.items()}
    made = {**end.card.made, "way": share, "kl": None}
    card = make_card(job.robot.spec, tensors, [dict(part) for part in end.card.observation], end.card.sizes(), **made)
    name = nearer_id(row["id"], share)
    job.save(name, Policy(tensors, card))
    return {
        **row,
        "id": name,
        "kl": None,
        "std": float(tensors["log_std"].exp().mean()),
        "way": share,
        "policy_hash": card.policy_hash,
        "curve": [],
    }
