"""The stage `nearer`: where nobody of an iteration may be tried, its candidates once more, closer to their anchors.

A training that went too far is not worth nothing: on the straight line of parameters back to the anchor, which may be
tried, falls and end stops become rarer, and some of the gain is left. As in training, where a candidate that ended
beyond its KL bound is brought back along the same line (`hts.rl.kl_bound.project_to_kl_bound`).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any

import torch

from hts.config import RunConfig
from hts.config_base import percent
from hts.policies.files import Policy, make_card
from hts.run.gate import tried
from hts.run.iteration import gated
from hts.run.job import Job
from hts.run.judging import judge
from hts.training.sweep import nearer_id

Report = Callable[[float], None]


def may_go_nearer(config: RunConfig) -> bool:
    """Whether a run may have this stage at all."""
    return config.gate.enabled and bool(config.gate.nearer)


def is_needed(job: Job, iteration: int) -> bool:
    """Whether nobody of an iteration may be tried, though somebody was trained to the end."""
    found = gated(job, iteration)
    return found is not None and found["strict"] and not found["elites"] and bool(_trained(job, iteration))


def nearer(job: Job, iteration: int, best: str, report: Report) -> dict[str, Any]:
    """Judge candidates at shares of the way from their anchors, and try them at the gate; policies beside the others.

    The result holds them as finetune.json, simulate.json and gate.json do.
    """
    shares = sorted(job.config.gate.nearer, reverse=True)
    told = " and ".join(f"{percent(one)} %" for one in shares)
    line = f"nobody of this iteration may be tried, so candidates are judged at {told} of the way from their anchors"
    job.stages.progress.say(f"iteration {iteration:02d}: {line}")
    rows, anchors = [], []
    for row in _trained(job, iteration):
        anchor = job.policy(best if row["anchor"] == "best" else row["anchor"])
        for share in shares:
            rows.append(_saved(job, row, anchor, share))
            anchors.append(anchor)
    judged = judge(job, iteration, job.read(f"iterations/{iteration:02d}/finetune"), rows, anchors)
    report(0.5)
    distances = judged.pop("kl")
    for row in rows:
        row["kl"] = distances[row["id"]]
        policy = job.policy(row["id"])
        made = {**policy.card.made, "kl": row["kl"]}
        job.save(row["id"], dataclasses.replace(policy, card=dataclasses.replace(policy.card, made=made)))
    found = tried(job, iteration, rows, judged, lambda share: report(0.5 + share / 2))
    return {"line": line, "candidates": rows, "simulate": judged, "gate": found}


def _trained(job: Job, iteration: int) -> list[dict[str, Any]]:
    """Rows of finetune.json that a training ended with; not those that were there before it."""
    rows = job.read(f"iterations/{iteration:02d}/finetune")["candidates"]
    return [row for row in rows if row["stopped"] is None and row["id"].startswith(f"{iteration:02d}-")]


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
