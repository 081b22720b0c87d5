"""The stage `confirm`: the best of all iterations are tried once more before one of them goes to the final.

One short trial flatters whoever wins it, and says little about the next session. So the best few walk again: on a
freshly warmed machine, at the speeds in reverse order, so that another speed comes before each, and charge and heat
are others when its turn comes. The best over both trials goes on; who falls or is refused now does not.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from hts.contracts import Selector, TestedCandidate
from hts.evaluation.across_speeds import mean_comparison
from hts.recordings.recording import robot_samples_of
from hts.run.job import Job
from hts.run.stages import Report
from hts.run.testing_elites import result_row, tested_before, whole


def confirm(job: Job, best: str, report: Report) -> dict[str, Any]:
    """Second trials of the best so far and those next to it, as many as `selection.confirm` says and
    `max_real_samples` leaves; nobody's where there are not two. The result's `best` goes to the final.
    """
    selector, before = job.selector(), tested_so_far(job)
    names = contenders(selector, before, best, job.confirmations(job.done_iterations))
    if len(names) < 2:
        left = [one for one in order(selector, before) if one != best]
        return {"tried": [], "results": {}, "recordings": [], "samples": 0, "best": best, "next": left}
    speeds = tuple(reversed(job.config.selection.tested_speeds))
    tests = whole(job, names, speeds, job.spent(job.done_iterations), report, before=1)
    ids = job.keep(tests.recorded, job.config.iterations + 1)
    found = over_both(before, {name: tests.results[name].tested for name in names})
    first = winner(selector, found, names) or job.first
    twice = order(selector, [one for one in found if one.id in names])
    once = order(selector, [one for one in found if one.id not in names])
    return {
        "tried": names,
        "results": {name: result_row(one) for name, one in tests.results.items()},
        "over_both": {
            one.id: {key: value.selection_score for key, value in one.comparisons.items()}
            for one in found
            if one.id in names
        },
        "recordings": ids,
        "samples": robot_samples_of(tests.recorded),
        "best": first,
        "next": [one for one in (*twice, *once) if one != first],
    }


def finalists(job: Job, best: str) -> list[str]:
    """Who may get a final, `evaluation.finals` at most: the best; who else was tried twice and kept; all the others by
    their one trial."""
    if best == job.first:
        return [best]
    if job.config.selection.confirm:
        others = job.read("confirm").get("next", [])  # of a run of before: nobody
    else:
        others = order(job.selector(), [one for one in tested_so_far(job) if one.id != best])
    return [best, *others][: job.config.evaluation.finals]


def order(selector: Selector, tested: Sequence[TestedCandidate]) -> list[str]:
    """Ids of all that the selector would choose, its best first."""
    return [one.id for one in ranked(selector, tested, len(tested))]


def tested_so_far(job: Job) -> list[TestedCandidate]:
    """All that reality measured in some iteration and did not refuse; whether they fell is for the selector."""
    rows = [job.read("test", index)["results"] for index in range(job.done_iterations)]
    return [tested_before(job, name) for row in rows for name, found in row.items() if found.get("tested")]


def contenders(selector: Selector, tested: Sequence[TestedCandidate], best: str, count: int) -> list[str]:
    """Ids of who is tried twice, `count` at most: the best so far, then the selector's best of the others; nobody where
    nobody improved. The best of a race need not have the highest score: who left it earlier was not in all rounds."""
    first = [one for one in tested if one.id == best]
    others = [one for one in tested if one.id != best]
    return [one.id for one in (*first, *ranked(selector, others, count - 1))][: max(0, count)] if first else []


def ranked(selector: Selector, tested: Sequence[TestedCandidate], count: int) -> list[TestedCandidate]:
    """The selector's best, then its best of the others, and so on; at most `count`."""
    left = list(tested)
    found: list[TestedCandidate] = []
    while left and len(found) < count:
        name = selector.best(left)
        if name is None:
            break
        found += [one for one in left if one.id == name]
        left = [one for one in left if one.id != name]
    return found


def over_both(before: Sequence[TestedCandidate], again: dict[str, TestedCandidate | None]) -> list[TestedCandidate]:
    """Everybody who was tested, with the mean of both trials where there were two; without those that were refused in
    the second one (None)."""
    found = []
    for first in before:
        second = again.get(first.id, first)
        if second is None:
            continue
        comparisons = {
            key: mean_comparison([first.comparisons[key], second.comparisons[key]]) for key in first.comparisons
        }
        found.append(TestedCandidate(first.id, comparisons, first.fell or second.fell, first.made))
    return found


def winner(selector: Selector, found: Sequence[TestedCandidate], twice: Sequence[str]) -> str | None:
    """The best of those that were tried twice; where none of them is left, the best of the others."""
    sure = [one for one in found if one.id in twice]
    return selector.best(sure) or selector.best([one for one in found if one.id not in twice])
