"""`report.html`: one self-contained, printable page about a finished run."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any

import yaml

import hts
from hts.atomic import atomic_write
from hts.errors import RunError
from hts.measurement.fit_report import clock_note, doubts, session_note
from hts.report import wording
from hts.report.data import Json, RunData, read_run
from hts.report.front import front_part
from hts.report.glossary import GLOSSARY
from hts.report.measurement_figure import proxy_r2
from hts.report.outcome import changes, closing
from hts.report.results import headline, result_rows
from hts.report.task_words import TaskWords

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SOURCES = {
    "twin": "a twin: a second simulation with other dynamics and its own simulated instruments, "
    "into which learning could not look",
    "field": "recorded by a person with a robot and imported",
}
"""Where the measurements of our own worlds come from; the end of a sentence."""
PRESET_NOTES = {"smoke": " (shows that everything runs: so few steps and seconds are no result)"}
"""What a stranger has to know of a preset, after its name."""
MANY = 8  # texts of one key, such as versions of packages; more of them are one line
PLAIN_VALUE = 160  # characters; longer ones (a diff) are left to provenance.json


def write_report(folder: Path) -> Path:
    """Write report.html and figures/*.svg, *.pdf into a run folder; returns the page's path.

    Raises RunError if the run is not finished, a file of it cannot be read, or the page cannot be written.
    """
    from jinja2 import Environment, StrictUndefined

    run = read_run(folder)
    template = resources.files("hts.report").joinpath("page.html.j2").read_text(encoding="utf-8")
    environment = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    path = Path(folder) / "report.html"
    try:
        atomic_write(path, environment.from_string(template).render(**contents(run)))
    except OSError as error:
        raise RunError(
            f"{path}: cannot be written ({error.strerror}). Make room or permission, then: hts report {folder}"
        ) from error
    return path


def contents(run: RunData) -> dict[str, Any]:
    """Everything the template shows; draws and saves the figures on the way."""
    summary = run.summary
    title, text = world_words(run)
    objectives = [_objective(run, name) for name in run.objectives]
    return {
        "title": f"{wording.label(' and '.join(run.objectives))} on {summary['robot']}"
        + (" in simulated reality" if run.world_simulated else ""),
        "where": run.where,
        "facts": _facts(run),
        "world_simulated": bool(run.world_simulated),
        "world_title": title,
        "world_text": text,
        "front": front_part(run, figure_note(run)),
        "objectives": objectives,
        "ending": closing(summary),
        "changed": changes(summary),
        "later": _later(run),
        "iterations": [_iteration(run, iteration) for iteration in run.iterations],
        "glossary": GLOSSARY.items(),
        "provenance": list(_flat(run.provenance)) or [("provenance.json", "not there")],
        "config": yaml.safe_dump(run.config, sort_keys=False, allow_unicode=True) if run.config else "",
        "version": hts.__version__,
    }


def world_words(run: RunData) -> tuple[str, str]:
    """Title and text that say what the measurements are: computed, or of a machine, or that nobody said."""
    if run.summary.get("note"):
        note, who = run.summary["note"].capitalize(), identity_words(run)
        if run.config.get("oracle_trains_in") == "simulation":
            return "No method.", (
                f"{note}. Candidates were trained in simulation, paid by what the instruments of the twin{who} exactly "
                "showed there. No robot was involved, and nobody beside a robot could do this: it is what a "
                "measurement model that never errs would be worth on this twin."
            )
        return "No method.", (
            f"{note}. Candidates were trained on the twin itself{who}, paid by what its instruments hide. No robot was "
            "involved, and nobody beside a robot could do this: it is a lower estimate of what is possible on this "
            "twin."
        )
    if run.world_simulated:
        source = SOURCES.get(run.world, f"the world '{run.world}', which computes its physics") + identity_words(run)
        return "Simulated reality.", (
            f"No robot was involved. The measurements come from {source}. They say what the method does there; what "
            "a real robot gains only a real robot can tell."
        )
    if run.world_simulated is False:
        source = SOURCES.get(run.world, f"made on a machine, in the world '{run.world}'") + identity_words(run)
        return "A real robot.", f"The measurements were {source}."
    return f"World: {run.world}.", "The measurements come from a world that a plugin offers."


def figure_note(run: RunData) -> str:
    """What a figure says of itself where it is shown without the page."""
    return f"simulated reality ({run.world}): no robot" if run.world_simulated else ""


def identity_words(run: RunData) -> str:
    """Which machine it was, in brackets; "" where nobody knows."""
    identity = run.summary.get("world_identity") or run.provenance.get("world") or {}
    told = ", ".join(f"{wording.label(name)} {str(value)[:12]}" for name, value in identity.items())
    return f" ({told})" if told else ""


def _facts(run: RunData) -> list[str]:
    summary = run.summary
    facts = [
        f"preset {summary['preset']}{PRESET_NOTES.get(summary['preset'], '')}",
        f"engine {summary['engine']}",
        f"seed {summary['seed']}",
        f"{len(run.iterations)} iteration{'' if len(run.iterations) == 1 else 's'}",
    ]
    if summary.get("note"):
        facts.append(summary["note"])
    elif run.config.get("reward_source", "model") != "model":
        facts.append("baseline: analytic proxy as reward")
    if summary.get("sim_steps") is not None:
        facts.append(f"{wording.count(summary['sim_steps'])} steps in simulation")
    if summary.get("real_samples") is not None:
        facts.append(f"{wording.count(summary['real_samples'])} samples {run.where.replace('in ', 'from ', 1)}")
    if falls := summary.get("first_data_falls"):
        facts.append(f"{falls} fall{'' if falls == 1 else 's'} in first data")
    if summary.get("wall_seconds") is not None:
        facts.append(wording.duration(summary["wall_seconds"]))
    return facts


# ---------------------------------------------------------------------------------------------- results


def _objective(run: RunData, name: str) -> dict[str, Any]:
    result = run.final.get(name) or {"unit": "1", "speeds": {}}
    shown = result_rows(name, result, run.task)
    return {
        **shown,
        "headline": headline(run, name, result),
        "figures": _figures(run, name),
        "cautions": _model_lines(run, name),
        "models": [
            {
                "index": iteration["index"],
                "r2": wording.number(model.get("held_out_r2"), 3),
                "proxy": wording.number(proxy_r2(run.fit(int(iteration["index"]), name)), 3),
                "rank": wording.number(model.get("rank_correlation")),
                "dataset": str(model.get("dataset") or "–")[:12],
            }
            for iteration in run.iterations
            if (model := (iteration.get("measurement_models") or {}).get(name))
        ],
    }


def _model_lines(run: RunData, name: str) -> list[str]:
    """Beside held-out R²: what makes it say less than it seems to, a line for each reason and iteration."""
    lines = []
    for one in run.iterations:
        index, model = int(one["index"]), (one.get("measurement_models") or {}).get(name) or {}
        fit, tried = run.fit(index, name), model.get("elites_r2")
        drifts = clock_note(fit)
        others = doubts(fit) if "r2" in (fit.get("held_out") or {}) else ()
        notes = [session_note(fit), drifts, *(one for one in others if not drifts or drifts not in one)]
        if tried is not None and tried < 0:
            notes.append(f"the policies that were tried are predicted worse than by their mean (R² {tried:.3g})")
        lines += [f"Iteration {index}: {note.removesuffix('.')}." for note in notes if note]
    return lines


def _later(run: RunData) -> dict[str, Any] | None:
    evaluation = run.evaluation
    if not evaluation.get("objectives"):
        return None
    task = TaskWords.of(evaluation)
    place = (evaluation.get("world"), evaluation.get("seed")) == (run.world, run.summary.get("seed"))
    again = place and _same_numbers(run.final, evaluation["objectives"])
    return {
        "text": f"policy {evaluation.get('policy', 'best')} against pretrained in world "
        f"{evaluation.get('world', 'unknown')}{' (simulated)' if evaluation.get('world_simulated') else ''}, seed "
        f"{evaluation.get('seed', 'unknown')}."
        + (
            " World and seed are those of the final, so it is the same walk again and confirms nothing."
            if again
            else ""
        ),
        "objectives": [result_rows(name, result, task) for name, result in evaluation["objectives"].items()],
    }


def _same_numbers(final: Json, later: Json) -> bool:
    """Whether a later comparison gave to the bit what the final had: a world answers the same question alike."""
    pairs = [
        (speed["improvement"], ((final.get(name) or {}).get("speeds") or {}).get(key, {}).get("improvement"))
        for name, result in later.items()
        for key, speed in result["speeds"].items()
    ]
    return bool(pairs) and all(one == other for one, other in pairs)


# ---------------------------------------------------------------------------------------------- figures


def _figures(run: RunData, objective: str) -> list[dict[str, str]]:
    import matplotlib

    from hts.report import figures, measurement_figure, style

    wanted: tuple[tuple[str, str, str, Callable[[RunData, str], Figure | None]], ...] = (
        (
            "improvement",
            "Improvement by speed",
            (
                "Final head-to-head against the pretrained policy (zero). Bars: 95 % intervals. Open marks, if any: "
                "the objective's other fractions."
            ),
            figures.improvement,
        ),
        (
            "distribution",
            "Segment by segment",
            (
                "Each point is one second of the final head-to-head, relative to the mean of the pretrained policy, by "
                "the first quantity that the objective scores, in that quantity's own unit unless it is a ratio. Short "
                "lines: means."
            ),
            figures.distribution,
        ),
        (
            "iterations",
            "Over the iterations",
            (
                "Measured improvement of every elite, and of the best one with its 95 % interval. The best of several "
                "noisy numbers is flattering; the final head-to-head measures afresh."
            ),
            figures.iterations,
        ),
        (
            "sweep",
            "Sweep",
            (
                "Left: every candidate by its distance from its anchor (dashed: the bounds c) and its score in "
                f"simulation; rings are elites, a white cross fell there. Right: what the elites gained {run.where}, "
                "with 95 % intervals; the best is in bold."
            ),
            figures.sweep,
        ),
        (
            "measurement",
            "Measurement model",
            (
                "Left: how well the model predicts recordings it was not fitted to, and how well it orders the "
                "policies that were tried. Right: each point is a policy of the held-out recordings at one commanded "
                "speed; on the line, prediction equals measurement."
            ),
            measurement_figure.measurement,
        ),
    )
    drawn = []
    with matplotlib.rc_context(style.RC):
        for name, title, caption, draw in wanted:
            drawing = draw(run, objective)
            if drawing is None:
                continue
            file = name if len(run.objectives) == 1 else f"{name}-{objective}"
            drawn.append(style.embedded(drawing, run.folder / "figures", file, title, caption, figure_note(run)))
    return drawn


# ------------------------------------------------------------------------------------------- candidates


def _iteration(run: RunData, iteration: Json) -> dict[str, Any]:
    rows = []
    for candidate in iteration.get("candidates") or []:
        measured = [
            (name, speed, result)
            for name, speeds in (candidate.get("real") or {}).items()
            for speed, result in speeds.items()
        ]
        several = len(measured) > len(run.objectives)  # then at several speeds
        best = candidate["id"] == iteration.get("best")
        rows.append(
            {
                "id": candidate["id"],
                "anchor": candidate["anchor"],
                "weights": wording.weights(candidate["weights"]).split(" + "),
                "bound": wording.bound(candidate["kl_bound"]),
                "kl": wording.number(candidate.get("kl"), 3),
                "score": [
                    wording.number(score, 3)
                    for score in (candidate.get("sim_scores") or {"": candidate.get("sim_score")}).values()
                ],
                "falls": wording.count(candidate.get("falls")),
                "fell": bool(candidate.get("falls")),
                "kind": "best" if best else "elite" if candidate.get("elite") else "",
                "predicted": _predicted(run, candidate) or ["–"],
                "improvement": [
                    (f"{run.task.point(speed)}: " if several else "")
                    + wording.quantity(result.get("improvement"), run.unit(name))
                    for name, speed, result in measured
                ]
                or ["refused" if candidate.get("refused") else "–"],
                "refused": candidate.get("refused"),
                "interval": [
                    wording.interval(result.get("improvement_ci95"), run.unit(name)) for name, _, result in measured
                ]
                or ["–"],
                "segments": _once([wording.count(result.get("segments")) for _, _, result in measured]) or ["–"],
            }
        )
    return {
        "index": iteration["index"],
        "rows": rows,
        "promises": any(row["predicted"] != ["–"] for row in rows),
        "warnings": iteration.get("warnings") or [],
        "scale": [
            f"Rewards of the task and of {name} spread by {wording.number(found['task_spread'])} and "
            f"{wording.number(found['measured_spread'])} per second in the first batch: they weigh the same at λ = "
            f"{found['equal_weight']:.2g}."
            for name, found in (iteration.get("reward_scale") or {}).items()
        ],
    }


def _predicted(run: RunData, candidate: Json) -> list[str]:
    """What the measurement models promised of a candidate before it was tried: improvements, slowest speed first."""
    promised = [
        (name, speed, speeds[speed])
        for name, speeds in (candidate.get("predicted") or {}).items()
        for speed in sorted(speeds, key=float)
    ]
    several = len(promised) > len(run.objectives)
    return [
        (f"{run.task.point(speed)}: " if several else "") + wording.quantity(one.get("improvement"), run.unit(name))
        for name, speed, one in promised
    ]


def _once(cells: list[str]) -> list[str]:
    """One where all are the same, else a line for each."""
    return cells[:1] if len(set(cells)) == 1 else cells


# ------------------------------------------------------------------------------------------- provenance


def _flat(value: Any, prefix: str = "") -> Iterable[tuple[str, str]]:
    """(key, text) of a nested JSON object; what is too long for a page is said to be in the file."""
    if isinstance(value, dict) and len(value) > MANY and all(isinstance(item, str) for item in value.values()):
        yield prefix, ", ".join(f"{key} {item}" for key, item in value.items())
    elif isinstance(value, dict):
        for key, item in value.items():
            yield from _flat(item, f"{prefix} / {key}" if prefix else str(key).replace("_", " "))
    elif isinstance(value, list) and not any(isinstance(item, dict | list) for item in value):
        yield from _flat(", ".join(map(str, value)), prefix)
    elif isinstance(value, list):
        yield prefix, f"{len(value)} entries, in provenance.json"
    else:
        text = "none" if value in (None, "") else str(value)
        long = len(text) > PLAIN_VALUE or "\n" in text
        yield prefix, f"{len(text.splitlines())} lines, in provenance.json" if long else text
