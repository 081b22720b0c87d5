"""What became of the elites, in words: how many were refused, why, how fast they went; who was chosen, and who was not.

A row is an elite's entry of `summary.json`, or of the result of the stage `test`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import groupby
from typing import Any

from hts.policy_ids import PRETRAINED
from hts.report.task_words import VELOCITY, TaskWords

Row = Mapping[str, Any]

SEVERAL = 3
"""So many iterations in a row that choose nobody are worth a sentence of their own."""

NOBODY_KEPT = (
    "No final head-to-head counts: nobody who got one could be compared at any speed, so the pretrained policy stays "
    "the best."
)

SMALLER = "try smaller λ (sweep.weights) or KL bounds (sweep.kl_bounds)"


def _advice(task: TaskWords, rows: Sequence[Row] = ()) -> str:
    numbers = [row.get("refusal") or {} for row in rows]
    if numbers and all("reference_walked" in one for one in numbers):
        return _own_fault(task, numbers)
    if task.velocity:
        return (
            f"Who is refused walks too unlike the command to be compared: {SMALLER}, or allow more "
            "(evaluation.speed_tolerance)."
        )
    return f"Who is refused does its task too little of the time to be compared: {SMALLER}."


def _own_fault(task: TaskWords, numbers: Sequence[Mapping[str, Any]]) -> str:
    """What to do where the pretrained policy itself did not do its task. numbers: of the refusals."""
    walked: dict[float, list[float]] = {}
    for one in numbers:
        if one["reference_walked"] is not None:
            walked.setdefault(one["speed"], []).append(one["reference_walked"])
    means = {speed: f"{sum(found) / len(found):.2f}{task.unit_after}" for speed, found in sorted(walked.items())}
    went = " and ".join(f"{mean}{task.at([f'{speed:g}'])}" for speed, mean in means.items())
    begin = f"The pretrained policy did no better{f' ({went})' if went else ''}, so λ need not be why: "
    others = "start from a policy that does its task (robot.policy)"
    if not task.velocity:
        return f"{begin}{others}."
    return f"{begin}ask for speeds that it reaches (selection.speed or speeds, evaluation.speeds), or {others}."


def fates(rows: Sequence[Row], task: TaskWords = VELOCITY) -> str:
    """Of so many elites: "2 of 3 refused (they went 0.55 and 0.61 m/s on average, 0.8 was commanded), 1 no better"."""
    refused = [row for row in rows if row.get("refused")]
    fell = [row for row in rows if not row.get("refused") and _fell(row)]
    rest = len(rows) - len(refused) - len(fell)
    parts = [f"{len(refused)} of {len(rows)} refused{_walked(refused, task)}"] if refused else []
    parts += [f"{len(fell)} fell"] if fell else []
    parts += [f"{rest} measured no better{_together(rows)}"] if rest else []
    return ", ".join(parts)


def nobody_chosen(
    rows: Sequence[Row], task: TaskWords = VELOCITY, refused: int = 0, over: Mapping[str, Any] | None = None
) -> str:
    """Of an iteration whose tests chose nobody: one sentence. refused: so many by the gate; over: the selector that
    chose nobody of so many `candidates` that could be tested, as the summary has it under `passed_over`."""
    if rows:
        return f"nobody was chosen: {fates(rows, task)}"
    why = _why_untested(refused, [] if over is None else [over])
    return f"nobody was tested: {why or 'every candidate fell or was stopped in simulation'}"


def closing(summary: Mapping[str, Any]) -> list[str]:
    """Sentences for the end of a run in which nobody, or for long nobody, was chosen, or elites gave up their task;
    empty if there is nothing to say."""
    iterations = [
        (one.get("index", number), one.get("best"), [row for row in one.get("candidates") or () if row.get("elite")])
        for number, one in enumerate(summary.get("iterations") or ())
    ]
    sentences, task = [], TaskWords.of(summary)
    if (summary.get("final") or {}).get("policy") == PRETRAINED:
        every = summary.get("iterations") or ()
        refused = sum(len((one.get("gate") or {}).get("refused") or ()) for one in every)
        why = _why_untested(refused, [one["passed_over"] for one in every if one.get("passed_over")])
        tried = [row for _, _, rows in iterations for row in rows]
        if summary["final"].get("given_up"):
            sentences.append(f"{NOBODY_KEPT} {_advice(task)}")
        else:
            sentences.append(_no_final(tried, bool(iterations), task, why))
    sentences += changes(summary)
    for number, one in enumerate(summary.get("iterations") or ()):
        sentences += [f"Iteration {one.get('index', number):02d}: {line}" for line in one.get("warnings") or ()]
    for nobody, group in groupby(iterations, key=lambda one: one[1] is None):
        streak = list(group)
        if nobody and SEVERAL <= len(streak) < len(iterations):  # if it is all of them, that is said above
            rows = [row for _, _, tried in streak for row in tried]
            about = fates(rows, task) or "nobody was tested"
            sentences.append(f"Iterations {streak[0][0]:02d} to {streak[-1][0]:02d} chose nobody: {about}.")
    return sentences


def changes(summary: Mapping[str, Any]) -> list[str]:
    """Why it was not the best of the first trials, or not the first final, that counts; empty where it was."""
    changed = second_trial(summary)
    return [*([changed] if changed is not None else []), *finals_before(summary)]


def second_trial(summary: Mapping[str, Any]) -> str | None:
    """What the second trials before the final changed: who lost them, who went to the final instead; None: nothing."""
    again = summary.get("confirmation") or {}
    before = [one.get("best_so_far") for one in summary.get("iterations") or ()]
    if not again.get("tried") or again["best"] == before[-1]:
        return None
    row = again["results"].get(before[-1]) or {}
    lost = "was refused" if row.get("refused") else "fell" if _fell(row) else "measured worse"
    after = "nobody is left" if again["best"] == PRETRAINED else f"{again['best']} went to the final"
    return f"Tried again before the final, {before[-1]} {lost}; {after}."


def finals_before(summary: Mapping[str, Any]) -> list[str]:
    """Of each policy whose final was not good enough, so that another one's counts: a sentence."""
    found, task = [], TaskWords.of(summary)
    for one in (summary.get("final") or {}).get("given_up") or ():
        points = {point for why in one["refused"].values() for point in why}
        lost = [f"was refused{task.at(points)}"] if points else []
        lost += ["could not be compared at all"] if one.get("error") else []
        lost += [f"fell {one['falls']} time{'' if one['falls'] == 1 else 's'}"] if one["falls"] else []
        taken = summary["final"]["policy"]
        found.append(f"In a final of its own {one['policy']} {' and '.join(lost)}; {taken} is the result.")
    return found


def _why_untested(refused: int, over: Sequence[Mapping[str, Any]]) -> str | None:
    """Why candidates were not tested that simulation let pass: the gate, the selector or both; None: there were none.
    over: of each iteration in which the selector chose nobody of those that could be tested."""
    gate = f"the gate before reality refused {refused}, and "
    if not over:
        return f"{gate}all others fell or were stopped in simulation" if refused else None
    left, name = sum(one["candidates"] for one in over), over[0]["selector"]
    whom = f"{left} {'other' if refused else 'candidate'}{'' if left == 1 else 's'}"
    return f"{gate if refused else ''}selector '{name}' chose nobody of {whom} that could be tested"


def _no_final(rows: Sequence[Row], known: bool, task: TaskWords, why: str | None) -> str:
    """why: candidates that simulation let pass were not tested, if so."""
    text = "No final head-to-head: "
    if rows and all(row.get("refused") for row in rows):
        text += "every elite was refused, so nothing could be compared; the pretrained policy stays the best."
        return f"{text} {_capital(fates(rows, task))}. {_advice(task, rows)}"
    if known and not rows:
        why = why or "all fell or were stopped in simulation"
        return f"{text}no candidate was tested, since {why}; the pretrained policy stays the best."
    together = _together(rows)
    stays = f"{together}; the pretrained policy stays the best." if together else ", which stays the best."
    text += f"no candidate measured better than the pretrained policy{stays}"
    return f"{text} {_capital(fates(rows, task))}." if rows else text


def _together(rows: Sequence[Row]) -> str:
    """Of several objectives one alone may well have gained."""
    return " in all objectives together" if any(len(row.get("real") or ()) > 1 for row in rows) else ""


def _walked(rows: Sequence[Row], task: TaskWords) -> str:
    """How fast refused elites went, or what else they achieved, where that was written down."""
    found = [row["refusal"] for row in rows if row.get("refusal")]
    speeds = [f"{one['walked']:.2f}" for one in found if one.get("walked") is not None]
    if not speeds:
        return ""
    commanded = " and ".join(f"{speed:g}" for speed in sorted({one["speed"] for one in found}))
    falls = sum(one.get("falls") or 0 for one in found)
    fell = f"; {falls} fall{'' if falls == 1 else 's'}" if falls else ""
    who = "it" if len(rows) == 1 else "they"
    if not task.velocity:
        asked = f", {commanded} was commanded" if task.commanded else ""
        return f" ({task.quantity} {_listed(speeds)}{task.unit_after} on average{asked}{fell})"
    return f" ({who} went {_listed(speeds)} m/s on average, {commanded} m/s was commanded{fell})"


def _fell(row: Row) -> bool:
    return bool(row.get("fell") or (row.get("tested") or {}).get("fell"))


def _listed(words: Sequence[str]) -> str:
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}"


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]
