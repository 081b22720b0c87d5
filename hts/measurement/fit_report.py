"""What `hts fit` prints: a line on the kept model, the table beside it, and what a person should know."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

from hts.measurement.comparison import SMOOTHED
from hts.measurement.drift import REMEDY, Drift, drift_note
from hts.measurement.outliers import Masked, told

WORSE_THAN_LINEAR = 0.1
"""By so much less variance explained a model is not worth its training."""
POOR_SPREAD = 2.0
"""Errors of policies' means that are more than so many times as large as a model says are worth a line."""
EXPLAINS = 0.1
"""Below so much variance explained on held-out recordings the sign of a fitted scale is chance."""
COUNTS = ("samples", "short")
"""Of what was left out."""
SHORT_SECONDS = 30.0
"""Less than this held out says little: another half minute may give another R²."""


def heading(report: Mapping[str, Any]) -> str:
    """How each line on a fit begins: a model may have the name of its target, so it says which is meant."""
    return f"target {report['target']}"


def summary_line(report: Mapping[str, Any]) -> str:
    """One line for a person, from the report of `fit_and_check`."""
    held = report["held_out"]
    if not held["recordings"]:
        fitted = len(report["training"])
        what = "one recording" if fitted == 1 else f"{fitted} recordings, each the only one of a policy that is kept"
        return (
            f"{heading(report)}: fitted to {what}, so none was held out and nothing is known of how well it "
            "predicts. Import two at least, or hold out its end: --split chronological=0.7"
        )
    proxy = (held["proxy"] or {}).get("smoothed")
    linear = held.get("linear")
    other = (report.get("model") or {}).get("name") != "linear"
    against = f", linear {_number(linear['r2'])}" if linear and other else ""
    against += f", analytic stand-in {_number(proxy['r2'])}" if proxy else ""
    interval = held.get("r2_interval")
    within = f" (95 % {_number(interval[0])} to {_number(interval[1])})" if interval else ""
    recordings, policies = len(held["recordings"]), len(held["policies"])
    many = f"{recordings} held-out recording{'s' if recordings > 1 else ''}"
    ranks = f"; rank correlation across {policies} policies {_number(report['rank_correlation'])}"
    return (
        f"{heading(report)}: R² {_number(report['held_out_r2'])}{within} on {many}, "
        f"{held['seconds']:.1f} s scored{against}{ranks if policies > 1 else ''}"
    )


def session_note(report: Mapping[str, Any]) -> str:
    """What makes held-out R² look better than another day would, a sentence to stand beside it; "" where nothing does.

    report: that of `fit_and_check`; one of an earlier version does not know.
    """
    shared = report.get("same_session") or {}
    count = shared.get("held_out", 0)
    if not count:
        return ""
    if count == shared["of"]:
        who = "what was held out is" if count == 1 else f"all {count} held-out recordings are"
    else:
        who = f"{count} of {shared['of']} held-out recordings {'is' if count == 1 else 'are'}"
    return (
        f"{who} of a session that was fitted to as well, so held-out R² says little of another day and may be lower "
        "there"
    )


def clock_note(report: Mapping[str, Any]) -> str:
    """What makes held-out R² that of the time since recordings began, likewise; "" where nothing does."""
    found = report.get("drift")
    slow = drift_note(report["target"], Drift(**found)) if found else ""
    if not slow:
        return ""
    return f"{slow}: held-out R² {_number(report['held_out_r2'])} tells mostly whether recordings began as warm"


def doubts(report: Mapping[str, Any]) -> list[str]:
    """What a person should know before a model is trusted, one line each; empty where nothing is wrong.

    report: that of `fit_and_check`.
    """
    held, head = report["held_out"], heading(report)
    model = report.get("model") or {}
    found, linear = held["r2"], (held.get("linear") or {}).get("r2")
    linear = None if model.get("name") == "linear" else linear  # whoever chose it is not told to choose it
    slow = clock_note(report)
    lines = []
    explains = linear is not None and linear >= WORSE_THAN_LINEAR  # else there is nothing in it to choose
    if found is not None and linear is not None and explains and linear - found >= WORSE_THAN_LINEAR:
        lines.append(
            f"{head}: held-out R² {_number(found)} is {_number(linear - found)} below that of `linear`, "
            f"{_number(linear)}. {_instead(model, report.get('fit') or {}, report['objective'])}, or record more."
        )
    elif found is not None and found < 0 and not slow:
        lines.append(
            f"{head}: held-out R² {_number(found)} is below 0: the mean of the data predicts better. Either the "
            "inputs do not explain it, or it remembers more than about a second (a temperature does): make a target of "
            "the loss that heats instead, or record more."
        )
    if slow:
        lines.append(f"{head}: {slow}; {REMEDY}.")
    line = (held.get("proxy") or {}).get("smoothed") or {}
    if _falls(line):
        lines.append(_falling(head, f"{line['scale']:.3g}"))
    means = (held.get("spread") or {}).get("policies") or []
    times = _times_too_small(means)
    if times > POOR_SPREAD:
        of = f"the means of {len(means)} policies are" if len(means) > 1 else "the mean of the held-out policy is"
        lines.append(f"{head}: the model's doubt is too small: {of} off by {times:.1f} times what it says.")
    return lines


def _times_too_small(means: Sequence[Mapping[str, float]]) -> float:
    """Root mean square of the errors of policies' means over that of the model's own standard deviations for them; 0
    without any. Single samples would not do: what a doubt says of them leaves out the sensor's own scatter and the old
    numbers that it shows between readings, and looks too small however right it is."""
    wide = sum(one["spread"] ** 2 for one in means)
    return math.sqrt(sum(one["error"] ** 2 for one in means) / wide) if wide > 0 else 0.0


def _falls(line: Mapping[str, Any]) -> bool:
    """Whether a stand-in's scale is negative and that means something: of one that explains nothing it is chance."""
    return (line.get("scale") or 0.0) < 0 and (line.get("r2") or 0.0) >= EXPLAINS


def _falling(head: str, found: str) -> str:
    """The line of a stand-in whose scale is negative; found: that scale, or the whole formula."""
    return (
        f"{head}: the analytic stand-in fits with a negative scale, {found}: more of it goes with less of "
        "the target. Either the log counts the other way (say sign: -1 when importing), or columns are swapped."
    )


def _instead(model: Mapping[str, Any], fit: Mapping[str, Any], objective: str) -> str:
    """What to do about a model that `linear` is better than: it may be fitted too shortly, or be made of it."""
    choose = f"--set objectives.{objective}.model=linear"
    member = model.get("member")
    if model.get("name") == "ensemble" and "linear" in (member, member.get("name") if isinstance(member, dict) else ""):
        return f"Its members see parts of the recordings: choose `linear` alone, {choose}"
    limit = {"epochs": "epochs", "time": "max_seconds"}.get(str(fit.get("stopped")))
    if limit is None or "epochs" not in fit:
        return f"Choose it, {choose}"
    many = f"{fit['epochs']} epoch{'' if fit['epochs'] == 1 else 's'}"
    longer = f"Its fit was ended after {many}: fit it longer, --set measurement.{limit}=NUMBER"
    return f"{longer}, choose `linear`, {choose}"


def _number(value: float | None) -> str:
    return "–" if value is None or not math.isfinite(value) else f"{value:.3f}"


def masked_lines(report: Mapping[str, Any], before: Mapping[str, Any] | None = None) -> list[str]:
    """How many samples the fit left out because no machine makes them, with the worst of each channel, in one line;
    empty where there are none, or as many as there were before.

    report: that of `fit_and_check`; before: that of an earlier fit to the first of the same recordings. What an earlier
    version wrote may not know.
    """
    found, known = report.get("masked") or {}, (before or {}).get("masked") or {}
    if not found.get("samples") or [found.get(key) for key in COUNTS] == [known.get(key) for key in COUNTS]:
        return []
    return [f"{heading(report)}: {told(Masked(**found))}"]


def cautions(report: Mapping[str, Any]) -> list[str]:
    """What `hts fit` says beside that of its own data and of the other models, one line each.

    report: what `fit_store` writes.
    """
    held, head, shared = report["held_out"], heading(report), report["shared"]
    lines = []
    if report["left_out"]:
        reasons = Counter(report["left_out"].values())
        why = "; ".join(f"{count}: {reason}" for reason, count in reasons.items())
        many = f"{len(report['left_out'])} recording{'s' if len(report['left_out']) > 1 else ''}"
        lines.append(f"{head}: {many} left out, listed in fit.json under `left_out` ({why}).")
    lines += masked_lines(report)
    if shared["held_out"]:
        both = (
            f"{head}: {shared['held_out']} of {shared['of']} held-out samples are in the recordings to fit to as well"
        )
        lines.append(
            f"{both}: {shared['removed']} samples, they and their neighbours, were taken out of the fit."
            if shared["removed"]
            else f"{both}, and were fitted to: what is said of them is no held-out figure."
        )
    if held["recordings"] and held["seconds"] < SHORT_SECONDS:
        lines.append(
            f"{head}: only {held['seconds']:.1f} s are scored, less than {SHORT_SECONDS:g} s: "
            "another stretch may give quite another R². Record more to hold out."
        )
    formula: Mapping[str, Any] = next((row for row in report["compared"] if row["name"] == SMOOTHED), {})
    if not held.get("proxy") and _falls(formula):  # of the objective's own `doubts` tells
        lines.append(_falling(head, formula["detail"]))
    kept = next(row for row in report["compared"] if row["kind"] == "kept")
    if kept["r2"] is not None:
        better = [row for row in report["compared"] if row["r2"] is not None and row["r2"] > kept["r2"]]
        if better:
            best = max(better, key=lambda row: row["r2"])
            loses = "loses to" if best["kind"] == "model" else "is no better than a formula: it loses to"
            lines.append(
                f"{head}: {kept['name']} {loses} {best['name']} on the same split, R² {_number(kept['r2'])} against "
                f"{_number(best['r2'])}."
            )
    lstm = next((row for row in report["compared"] if row["name"] == "lstm" and row["kind"] != "kept"), None)
    if lstm is not None and None not in (lstm["r2"], kept["r2"]) and lstm["r2"] < kept["r2"]:
        lines.append(
            f"{head}: the LSTM loses to {kept['name']}, R² {_number(lstm['r2'])} against {_number(kept['r2'])}."
        )
    return lines


def table(report: Mapping[str, Any]) -> list[str]:
    """All models on the same split, one line each, with a head."""
    rows = report["compared"]
    validated = any(row["cross_validated"] is not None for row in rows)
    width = max(len(row["name"]) + 2 * (row["kind"] == "kept") for row in rows)
    inner = f"{'inside':>8}  " if validated else ""
    unit = report["held_out"].get("unit", "")
    head = f"{'model':<{width}}  {inner}{'R²':>7}  {'95 %':<17}  {'RMSE, ' + unit:>10}  fitted"
    lines = [head.rstrip()]
    for row in rows:
        name = row["name"] + (" *" if row["kind"] == "kept" else "")
        interval = row["r2_interval"]
        within = f"{_number(interval[0])} to {_number(interval[1])}" if interval else "–"
        inner = f"{_number(row['cross_validated']):>8}  " if validated else ""
        rmse = "–" if row["rmse"] is None else f"{row['rmse']:.4g}"
        line = f"{name:<{width}}  {inner}{_number(row['r2']):>7}  {within:<17}  {rmse:>10}  {row['detail']}"
        lines.append(line.rstrip())
    notes = ["* kept"]
    if validated:
        notes.append("inside: R² by cross-validation within what is fitted to, by which it was chosen")
    return [*lines, "; ".join(notes)]
