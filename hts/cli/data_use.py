"""`hts data lag` and `hts data enough`: what a store is good for, as lines of text or as JSON."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from hts.contracts import Objective
    from hts.measurement.wanted import Wanted
    from hts.recordings.recording import Recording


def show_lag(store: Path, objective: str | None, wanted: Wanted, as_json: bool) -> list[str]:
    """How late the gauge is: the objective's, or what is wanted."""
    from hts.measurement.drift import drift, drift_note
    from hts.recordings.lag import gauge_lag

    made, recordings = _usable(store, objective, wanted)
    found = gauge_lag(recordings, made.target.name, made.inputs)
    if as_json:
        return [json.dumps(None if found is None else asdict(found), indent=2)]
    slow = drift_note(made.target.name, drift(recordings, made.target.name))
    lines = [f"'{made.target.name}': {slow}; that is no sensor's lag."] if slow else []
    if found is None:
        why = (
            f"'{made.target.name}': no lag can be told, {', '.join(made.inputs)} explain too little of it. Record "
            "motion that changes."
        )
        return lines or [why]
    return [f"'{made.target.name}' is late by {found}; {len(recordings)} recordings", *lines]


def show_enough(
    store: Path, objective: str | None, wanted: Wanted, speeds: Sequence[float], as_json: bool
) -> tuple[list[str], bool | None]:
    """The lines, and the verdict: None where it cannot be said whether this is enough."""
    from hts.errors import ConfigError, RecordingError
    from hts.measurement.enough import enough
    from hts.recordings.lag import EARLY_SECONDS, gauge_lag

    if odd := [speed for speed in speeds if not math.isfinite(speed)]:
        raise ConfigError(f"--speed {odd[0]}: expected a number, m/s or in the unit of the task's set-point.")
    made, recordings = _usable(store, objective, wanted)
    found = enough(made, recordings, speeds)
    try:
        late = gauge_lag(recordings, made.target.name, made.inputs)
    except RecordingError:  # too short to tell
        late = None
    if late is not None and late.seconds < -EARLY_SECONDS:
        early = (
            f"'{found.target}' is early by {-late.seconds:.3g} s: the joints are stamped late, or by another clock; "
            "import both again with stamps of one"
        )
        found = replace(found, missing=(*found.missing, early))
    if as_json:
        known = {**found.as_json(), "enough": found.verdict, "lag": None if late is None else asdict(late)}
        return [json.dumps(known, indent=2)], found.verdict
    at = ", ".join(f"{speed:g} ({seconds:.0f} s)" for speed, seconds in found.speeds.items()) or (
        "not stated (recording.schedule in the mapping)"
    )
    lines = [
        f"{len(recordings)} recordings, {found.seconds:.0f} s, {found.policies} policies; speeds {at}",
        f"inputs move along {found.directions} of {found.inputs} directions",
        f"lag of '{found.target}': {late or 'cannot be told'}",
    ]
    r2 = "–" if found.r2 is None else f"{found.r2:.2f}"
    lines.append(f"held out {'by policy' if found.by_policy else 'the last part of each recording'}: R² {r2}")
    for one in found.held_out:
        error, unit = f"{one.mean_error:+.3g}", found.unit
        along = "–" if one.r2 is None else f"{one.r2:.2f}"
        name = one.policy[:12] or "(no policy named)"
        lines.append(f"  {name}: {one.seconds:.0f} s, mean {one.measured:.4g} {unit}, error {error} {unit}, R² {along}")
    lines += [f"missing: {line}" for line in found.missing]
    lines += [f"cannot be said: {line}" for line in found.unsaid]
    lines.append(_VERDICTS[found.verdict])
    return lines, found.verdict


_VERDICTS = {
    True: "Enough: nothing is missing.",
    False: "Not enough for a model to trust.",
    None: "Nothing is missing of what can be told.",
}


def _usable(store: Path, objective: str | None, asked: Wanted) -> tuple[Objective, list[Recording]]:
    """What is predicted, and the recordings that have its inputs and target."""
    from hts.errors import RecordingError
    from hts.measurement.wanted import without_objective
    from hts.plugins import load
    from hts.recordings.store import RecordingStore

    asked.name(objective)  # what is wrong with the question comes before what is wrong with the store
    named = None if objective is None else load().make_objective(objective)
    opened = RecordingStore(store)
    made = without_objective(opened, asked) if named is None else named
    wanted = (*made.inputs, made.target.name)
    usable = [one for one in opened.ids() if all(name in opened.attributes(one)["arrays"] for name in wanted)]
    if not usable:
        raise RecordingError(
            f"{store}: none of its {len(opened.ids())} recordings has all of {', '.join(wanted)}. `hts data show` "
            "lists their channels; import logs that hold these."
        )
    return made, [opened.read(one, wanted) for one in usable]
