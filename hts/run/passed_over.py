"""Who could have been tried for real where nobody was: whether simulation and gate left nobody, or the selector chose
nobody of those that they left."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from hts.run import iteration
from hts.run.job import Job
from hts.run.judging import is_lenient, may_be_tested, same_policies


def passed_over(job: Job, index: int) -> dict[str, Any] | None:
    """{"selector": name, "candidates": how many could have been tried} of an iteration in which the selector chose
    nobody of them; None where somebody was chosen, or nobody could have been."""
    if iteration.elites_of(job, index):
        return None
    rows, simulated = iteration.tuned(job, index)["candidates"], iteration.simulated(job, index)
    left = could_be_tried(rows, simulated["falls"], iteration.gated(job, index), is_lenient(job))
    return {"selector": job.config.selection.selector.name, "candidates": len(left)} if left else None


def could_be_tried(
    rows: Sequence[Mapping[str, Any]], falls: Mapping[str, int], gated: Mapping[str, Any] | None, lenient: bool
) -> list[str]:
    """Ids of the candidates that a selector may name: who is not the same policy as an earlier one, was not refused by
    the gate, and neither fell nor was stopped in simulation (lenient: whoever did).

    rows: of finetune.json; falls: of each candidate, in simulation; gated: as gate.json, None of a run without a gate.
    """
    out = same_policies(rows)
    if gated is not None:
        out |= {name for name, row in gated["policies"].items() if not row["passed"]}
    return [
        row["id"] for row in rows if row["id"] not in out and may_be_tested(falls[row["id"]], row["stopped"], lenient)
    ]
