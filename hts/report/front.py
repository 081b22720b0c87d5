"""The page's part about the front of several objectives: figures, words and a table."""

from __future__ import annotations

import itertools
from typing import Any

from hts.policy_ids import PRETRAINED
from hts.report import wording
from hts.report.data import RunData

FRONT_CAPTION = (
    "Left: every policy that was tried, by what its gain over the pretrained policy (diamond) counts as; bars are 95 "
    "% intervals (a mean over several speeds has none), crosses fell. Dark: the front, beaten by no other in both at "
    "once; the line is the edge of what it beats. Ringed: the final policy. Right: every candidate by its scores in "
    "simulation above those of the pretrained policy; each iteration has measurement models of its own, so that its "
    "points compare among themselves."
)


def front_part(run: RunData, note: str = "") -> dict[str, Any] | None:
    """With several objectives: the policies that no other beats in all of them, as figures, words and a table.
    note: as of `style.embedded`."""
    if len(run.objectives) < 2 or not run.front:
        return None
    tested = sum(bool(candidate.get("real")) for candidate in run.candidates)
    return {
        "text": front_text(run, tested),
        "speeds": _speeds(run),
        "measured": any(result.get("speeds") for result in run.final.values()),
        "figures": front_figures(run, note),
        "objectives": run.objectives,
        "rows": front_rows(run),
    }


def front_text(run: RunData, tested: int) -> str:
    """How many of the tested policies are on the front, and whether the pretrained one is."""
    names = " and ".join(run.objectives)
    found = [entry for entry in run.front if entry["id"] != PRETRAINED]
    if not found:
        fell = any(candidate.get("fell") for candidate in run.candidates)
        upright = " without falling" if fell else ""
        none = f"None of the {tested} policies tried {run.where} gains in any of {names}{upright}"
        return f"{none}: the pretrained policy is the front."
    verb = "is" if len(found) == 1 else "are"
    text = (
        f"{len(found)} of {tested} policies tried {run.where} {verb} beaten by no other in {names} together. They are "
        "compared by what counts, which an objective may make stricter than its improvement (the smaller of two "
        "savings, say)."
    )
    if len(found) < len(run.front):
        text += " None of them gains in everything, so that the pretrained policy is one of the front too."
    return text


def _speeds(run: RunData) -> str:
    """Where the head-to-heads of the iterations were walked."""
    name = run.objectives[0]
    speeds = {speed for iteration in run.iterations for _, speed, _ in run.tested(iteration, name)}
    return run.task.at(speeds)


def front_rows(run: RunData) -> list[dict[str, Any]]:
    """The table of the front, best first in the first objective."""
    rows = []
    order = sorted(run.front, key=lambda entry: -entry["improvements"][run.objectives[0]]["selection_score"])
    for entry in order:
        candidate = run.candidate(entry["id"])
        rows.append(
            {
                "id": entry["id"],
                "best": entry["id"] == run.chosen,
                "weights": wording.weights(candidate["weights"]) if candidate else "–",
                "bound": wording.bound(candidate["kl_bound"]) if candidate else "–",
                "gains": [
                    (
                        wording.quantity(entry["improvements"][name]["improvement"], run.unit(name)),
                        wording.interval(entry["improvements"][name].get("improvement_ci95"), run.unit(name)),
                        wording.quantity(entry["improvements"][name]["selection_score"], run.unit(name)),
                    )
                    for name in run.objectives
                ],
            }
        )
    return rows


def front_figures(run: RunData, note: str) -> list[dict[str, str]]:
    import matplotlib

    from hts.report import front_figure, style

    drawn = []
    with matplotlib.rc_context(style.RC):
        for pair in itertools.combinations(run.objectives, 2):
            drawing = front_figure.front(run, pair)
            if drawing is None:
                continue
            file = "front" if len(run.objectives) == 2 else f"front-{pair[0]}-{pair[1]}"
            drawn.append(
                style.embedded(
                    drawing, run.folder / "figures", file, f"Front of {pair[0]} and {pair[1]}", FRONT_CAPTION, note
                )
            )
    return drawn
