"""The stage `final`: the best policy against the pretrained one at every speed.

Trials are short, and a machine whose floor and wind change may keep a speed in two of them and lose it in the third. A
policy to which a speed is refused, or that falls, serves nobody: then the next of those that trials found good has a
final of its own, until one keeps every speed or `evaluation.finals` of them were tried. What was saved decides nothing
here; all that was walked is kept and counted.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from hts.evaluation.final import entry_and_scores, falls_by_speed
from hts.evaluation.held import NotComparable, ask_to_hold
from hts.policy_ids import PRETRAINED
from hts.recordings.recording import Recording, robot_samples_of
from hts.run.head_to_head import ends_the_run, head_to_head, held_head_to_head
from hts.run.iteration import gate_note
from hts.run.job import Job
from hts.run.stages import Report, write_json


@dataclass
class Tried:
    """One final. entries: `final.objectives` of `summary.json`; scores: `segments.json`; blamed: speeds at which
    it was refused for what it did itself; fallen: speed -> how often it fell, in all that it walked; error: nothing
    could be compared at any speed."""

    policy: str
    entries: dict[str, Any] = field(default_factory=dict)
    scores: dict[str, Any] = field(default_factory=dict)
    recordings: list[Recording] = field(default_factory=list)
    blamed: set[str] = field(default_factory=set)
    fallen: Mapping[str, int] = field(default_factory=dict)
    error: NotComparable | None = None

    @property
    def refused(self) -> dict[str, dict[str, str]]:
        """Objective -> speed -> why; held speeds where they were held."""
        return {name: entry["refused"] for name, entry in self.entries.items() if entry.get("refused")}

    @property
    def lost(self) -> float:
        """At how many of its speeds it was refused or fell; infinite where nothing is left."""
        if self.error is not None:
            return math.inf
        return len(self.blamed | self.fallen.keys())

    def given_up(self) -> dict[str, Any]:
        """What `summary.json` says of it where another one was taken."""
        return {
            "policy": self.policy,
            "refused": self.refused,
            "falls": sum(self.fallen.values()),
            **({"error": str(self.error)} if self.error else {}),
        }


def final(job: Job, finalists: Sequence[str], report: Report) -> dict[str, Any]:
    """The first of the finalists who keeps every speed, else the one who loses fewest; also writes policies/best.*

    Where the run holds the speed it is done twice: held, and at equal commands as in the paper. Where none of them
    keeps any speed the policy to start from stays the best. Raises EvaluationError if that one cannot be judged at any.
    """
    if finalists[0] == PRETRAINED:
        return _stays(job, [])
    tried: list[Tried] = []
    for number, name in enumerate(finalists):
        tried.append(_final_of(job, name, report))  # from nothing again: nobody knows whether another one follows
        error = tried[-1].error
        if tried[-1].lost == 0 or (error is not None and error.role == "reference"):  # no policy helps against that
            break
        if number + 1 < len(finalists):
            job.say(f"{_why(tried[-1])} Next: {finalists[number + 1]}.")
    chosen = min(tried, key=lambda one: one.lost)
    if chosen.error is not None:  # so has everybody's
        for one in tried:
            if one.error is not None and one.error.role == "reference":
                raise ends_the_run(one.error, job.world) from one.error
        return _stays(job, tried)
    if chosen is not tried[-1]:
        _as_best(job, chosen.policy)
    write_json(job.folder / "segments.json", chosen.scores)
    return {
        "policy": chosen.policy,
        "objectives": chosen.entries,
        "given_up": [one.given_up() for one in tried if one is not chosen],
        **_walked(job, tried),
    }


def _stays(job: Job, tried: Sequence[Tried]) -> dict[str, Any]:
    """The policy to start from is the result: nobody is to have a final, or nobody kept any speed in theirs."""
    _as_best(job, PRETRAINED)
    given_up = {"given_up": [one.given_up() for one in tried]} if tried else {}
    return {"policy": PRETRAINED, "objectives": {}, **given_up, **_walked(job, tried)}


def _walked(job: Job, tried: Sequence[Tried]) -> dict[str, Any]:
    """What all finals recorded, kept in the run's store."""
    recordings = [recording for one in tried for recording in one.recordings]
    return {
        "recordings": job.keep(recordings, job.config.iterations + 1) if recordings else [],
        "samples": robot_samples_of(recordings),
    }


def _why(tried: Tried) -> str:
    """Why a final was not good enough, in one line."""
    if tried.error is not None:
        return f"{tried.policy}: {tried.error}"
    if tried.refused:
        return f"{tried.policy}: {next(iter(next(iter(tried.refused.values())).values()))}"
    return f"{tried.policy} fell in its final."


def _as_best(job: Job, name: str) -> None:
    """Export a policy as the best one, with what the gate found of it."""
    job.save("best", job.policy(name))
    found = gate_note(job, name)
    if found is not None:
        job.note_gate("best", found)
    else:  # nobody looked at this one: what was found of a finalist before is not its
        job.onnx_path("best").with_suffix(".gate.json").unlink(missing_ok=True)


def blamed(refused: Mapping[str, NotComparable]) -> set[str]:
    """Speeds that are refused for what the policy did; the reference's are no reason to take another policy."""
    return {speed for speed, why in refused.items() if why.role == "policy"}


def _final_of(job: Job, name: str, report: Report) -> Tried:
    """The final of one policy."""
    config, tried = job.config, Tried(name)
    _as_best(job, name)
    held: list[Recording] | None = None
    if job.hold is not None:
        job.watch(lambda share: report(share / 2))
        held, again = held_head_to_head(job, "best", job.hold)
        job.watch(lambda share: report((1 + share) / 2))
        ask_to_hold(job.world, None)  # the paper's figures beside: equal commands
        tried.recordings += [*held, *again]
    else:
        job.watch(report)
    recordings = head_to_head(job, "best")
    tried.recordings += recordings
    seed, task = job.seed("interval", "final"), job.robot.task()
    tried.fallen = falls_by_speed(tried.recordings, task)
    try:
        for key, objective in job.objectives.items():
            found = entry_and_scores(objective, held, recordings, config.evaluation, seed, task)
            tried.entries[key], tried.scores[key], refused = found
            tried.blamed |= blamed(refused)
    except NotComparable as error:
        tried.error = error
    return tried
