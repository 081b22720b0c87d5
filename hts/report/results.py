"""What the final head-to-heads gave: tables of one objective, and a sentence or two above them."""

from __future__ import annotations

from typing import Any

from hts.report import wording
from hts.report.data import Json, RunData
from hts.report.task_words import TaskWords
from hts.report.wording import HELD


def result_rows(name: str, result: Json, task: TaskWords) -> dict[str, Any]:
    """The result tables of one objective: one, or one at held speed and one at equal commands."""
    tables = [
        {
            **_result_table(result["unit"], part["speeds"], task, result.get("metric_units") or {}),
            "words": words.removeprefix(", "),
            "held": words == HELD,
            "refused": list((part.get("refused") or {}).values()),
        }
        for part, words in wording.ways(result)
    ]
    return {
        "name": name,
        "tables": tables,
        "rows": tables[0]["rows"],
        "set_point": task.heading,
        "achieved": task.achieved,
    }


def _result_table(unit: str, speeds: Json, task: TaskWords, units: Json) -> dict[str, Any]:
    """Columns and rows of one table. units: of metrics, by name."""
    metrics, same = wording.metric_names(speeds)
    rows = []
    for key in sorted(speeds, key=float):
        speed = speeds[key]
        bounds = speed.get("improvement_ci95")
        reference = speed.get("reference") or {}
        valid = speed.get("valid")
        rows.append(
            {
                "speed": task.point(key),
                "at": task.at([key]).strip() or "against the pretrained policy",
                "improvement": wording.quantity(speed["improvement"], unit),
                "interval": wording.interval(bounds, unit),
                "every_second": _every_second(speed.get("every_second"), unit),
                "above_zero": bool(bounds) and bounds[0] > 0,
                "metrics": [wording.metric(metric, (speed.get("metrics") or {}).get(metric)) for metric in metrics],
                "mean_speed": _pair(speed.get("mean_speed"), reference.get("mean_speed"), task),
                "commanded": _pair(speed.get("commanded"), reference.get("commanded"), task),
                "falls": wording.count(speed.get("falls")),
                "fell": bool(speed.get("falls")),
                "segments": wording.count(speed.get("segments"))
                + (f" ({100 * valid:.0f} %)" if valid is not None else ""),
            }
        )
    return {
        "metrics": [wording.heading(metric, units) for metric in metrics],
        "improvement": "improvement" + "".join(f" ({wording.label(metric).lower()})" for metric in same),
        "rows": rows,
        "every_second": any(_left_out(speed) for speed in speeds.values()),
    }


def _left_out(speed: Json) -> bool:
    """Whether seconds of either policy did not count, for their speed or for a fall."""
    reference = speed.get("reference") or {}
    return bool(speed.get("every_second")) and min(speed.get("valid", 1.0), reference.get("valid", 1.0)) < 1.0


def _every_second(found: Json | None, unit: str) -> str:
    """The improvement whatever the speed of a second was, and its interval."""
    if not found:
        return "–"
    bounds = found.get("improvement_ci95")
    return wording.quantity(found["improvement"], unit) + (f" ({wording.interval(bounds, unit)})" if bounds else "")


def _pair(policy: float | None, reference: float | None, task: TaskWords) -> str:
    """What the policy achieved, or what it was sent, and, in brackets, the same of the reference."""
    return task.amount(policy) + (f" ({wording.number(reference)})" if reference is not None else "")


def headline(run: RunData, name: str, result: Json) -> str:
    """The result in one sentence or two, without more certainty than the intervals have."""
    speeds = result["speeds"]
    if not speeds:
        return " ".join((result.get("refused") or {}).values())
    unit = result["unit"]
    better = [key for key in speeds if (bounds := speeds[key].get("improvement_ci95")) and bounds[0] > 0]
    worse = [key for key in speeds if (bounds := speeds[key].get("improvement_ci95")) and bounds[1] < 0]
    policy = f"the final policy ({run.chosen})" if run.chosen else "the final policy"
    refused = result.get("refused") or {}
    if len(better) == len(speeds) and not refused:
        values = sorted(speed["improvement"] for speed in speeds.values())
        spread = (
            wording.interval((values[0], values[-1]), unit) if len(values) > 1 else wording.quantity(values[0], unit)
        )
        where = run.task.at(better) if len(better) == 1 else run.task.everywhere
        text = f"Against the pretrained policy, {policy} improves {name} by {spread}{where}."
    else:
        neither = "not clearly either" if better or worse else "neither clearly better nor clearly worse"
        parts = [(better, "better"), (worse, "worse"), ([k for k in speeds if k not in better + worse], neither)]
        found = ", ".join(f"{word}{run.task.at(keys)}" for keys, word in parts if keys)
        text = f"Against the pretrained policy, {policy} is, for {name}, {found}."
    for speed, why in refused.items():
        where = run.task.at([speed])
        text += f" It is not judged{where}: {why.removeprefix(f'Head-to-head{where}: ')}"
    if "open_loop" in result:
        text += " Both walked at held speed: their commands were trimmed by the measured speed, then frozen."
    return f"{text} {_fell(result)}"


def _fell(result: Json) -> str:
    """How often it fell in all of its final: held and at equal commands, at refused speeds too."""
    beside = result.get("open_loop") or {}
    falls, elsewhere = _falls(result), _falls(beside)
    if not falls and not elsewhere:
        return "It did not fall."
    count, where = falls + elsewhere, ""
    if elsewhere:
        where = f", {elsewhere} of them at equal commands" if falls else ", all at equal commands"
    return f"It fell {count} time{'' if count == 1 else 's'}{where}."


def _falls(way: Json) -> int:
    judged = sum(speed.get("falls") or 0 for speed in (way.get("speeds") or {}).values())
    return judged + sum((way.get("refused_falls") or {}).values())
