"""Whether recordings are enough for a model that one may trust with policies it has not seen.

A measurement model is asked about candidates: policies that nobody recorded. So each recorded policy is held out in
turn, `linear` is fitted to the others, and its error is what to expect. Beside that stand the things without which no
error can be told, or which a robot cannot be asked to walk without: seconds, policies, speeds, and inputs that move
independently of each other. The bounds are rules of thumb, stated with each verdict.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from hts.contracts import Signals
from hts.guarded import guarded
from hts.measurement.checks import traces_of
from hts.measurement.data import check_units, recorded_signals
from hts.measurement.drift import REMEDY, drift, drift_note
from hts.measurement.linear import Linear, LinearSettings
from hts.measurement.scoring import Trace, commanded_speed, pooled_r2, r2
from hts.measurement.shared import copies, told_of_copies
from hts.measurement.split import named_part
from hts.recordings.on_schedule import stated

if TYPE_CHECKING:
    from hts.contracts import Objective
    from hts.recordings.recording import Recording

LEAST_SECONDS = 120.0
SECONDS_AT_A_SPEED = 20.0
SAME_SPEED = 0.05
"""Commanded speeds nearer than this to one that is asked about count for it, m/s or the unit of a set-point."""
LEAST_POLICIES = 3
LEAST_R2 = 0.6
LEAST_DIRECTIONS = 1 / 3
"""Share of the input numbers along which 95 % of their variance must be spread."""
HELD_OUT_SHARE = 0.3
MOST_FITS = 8


@dataclass(frozen=True)
class HeldOut:
    """What was predicted of one policy by a model that had not seen it. mean_error: of the level, in the target's
    unit; measured: the mean itself; r2: along its recordings, None where nothing varies."""

    policy: str
    seconds: float
    measured: float
    mean_error: float
    r2: float | None


@dataclass(frozen=True)
class Enough:
    """seconds: of all; speeds: commanded speed -> seconds; directions, inputs: along how many of how many the inputs
    move; held_out: by policy, or the last part of the data where there is one policy; by_policy: which of both;
    r2: of all held out; missing: one line for each thing to record, none where it is enough; unsaid: one line for each
    question that these recordings do not answer, such as what was walked at a speed where nobody stated the speeds."""

    target: str
    unit: str
    seconds: float
    policies: int
    speeds: dict[float, float]
    directions: int
    inputs: int
    by_policy: bool
    held_out: tuple[HeldOut, ...]
    r2: float | None
    missing: tuple[str, ...]
    unsaid: tuple[str, ...] = ()

    @property
    def verdict(self) -> bool | None:
        """Whether it is enough; None where nothing is missing but a question has no answer."""
        return False if self.missing else None if self.unsaid else True

    def as_json(self) -> dict[str, Any]:
        """Plain JSON values."""
        found = asdict(self)
        return {**found, "speeds": {f"{speed:.12g}": seconds for speed, seconds in self.speeds.items()}}


def enough(objective: Objective, recordings: Sequence[Recording], speeds: Sequence[float] = ()) -> Enough:
    """The verdict on recordings that have the objective's inputs and target.

    speeds: at which the policies are to be judged, m/s or set-points; without them only what was commanded is told.
    Raises RecordingError for recordings that no model can be fitted to.
    """
    signals = recorded_signals(objective, recordings[0])
    for one in recordings:
        check_units(signals, one)
    channels = (*objective.inputs, objective.target.name)
    twice, again = told_of_copies(recordings, channels), {id(other) for _, other in copies(recordings, channels)}
    recordings = [one for one in recordings if id(one) not in again]
    policies = list(dict.fromkeys(one.policy_hash for one in recordings))
    at, unstated = _speeds(recordings)
    seconds = float(sum(one.seconds for one in recordings))
    directions, inputs = _directions(signals, recordings)
    by_policy = len(policies) > 1
    pairs = _by_policy(recordings, policies) if by_policy else _by_time(recordings)
    held_out, found = _held_out(objective, signals, pairs)
    too_slow, unsaid = _at_speeds(speeds, at, unstated)
    missing = [
        *twice,
        *_too_little(seconds, policies),
        *too_slow,
        *_too_alike(directions, inputs),
        *_too_wrong(held_out, found, by_policy, objective.target.unit),
    ]
    if slow := drift_note(objective.target.name, drift(recordings, objective.target.name)):
        missing.append(f"{slow}, and more recordings do not help: {REMEDY}")
    return Enough(
        target=objective.target.name,
        unit=objective.target.unit,
        seconds=seconds,
        policies=len(policies),
        speeds=at,
        directions=directions,
        inputs=inputs,
        by_policy=by_policy,
        held_out=tuple(held_out),
        r2=found,
        missing=tuple(missing),
        unsaid=tuple(unsaid),
    )


def _speeds(recordings: Sequence[Recording]) -> tuple[dict[float, float], float]:
    """Seconds at each commanded speed, and those of recordings that state none."""
    at: dict[float, float] = defaultdict(float)
    unstated = 0.0
    for one in recordings:
        if not stated(one.notes):
            unstated += one.seconds
            continue
        for speed, count in zip(*np.unique(commanded_speed(one), return_counts=True), strict=True):
            at[float(speed)] += float(count) / one.rate_hz
    return dict(sorted(at.items())), unstated


def _directions(signals: Signals, recordings: Sequence[Recording]) -> tuple[int, int]:
    """Along how many directions 95 % of the variance of the standardised inputs lies, and how many inputs move."""
    names = signals.names
    parts = [np.concatenate([r.values(n).reshape(r.num_samples, -1) for n in names], axis=1) for r in recordings]
    rows = np.concatenate(parts).astype(np.float64)
    spread = rows.std(0)
    moving = rows[:, spread > 1e-9] / spread[spread > 1e-9]
    if moving.shape[1] == 0:
        return 0, 0
    shares = np.linalg.eigvalsh(np.cov(moving, rowvar=False).reshape(moving.shape[1], -1))[::-1]
    return int(np.searchsorted(np.cumsum(shares) / shares.sum(), 0.95) + 1), int(moving.shape[1])


Pair = tuple[str, list["Recording"], list["Recording"]]


def _by_policy(recordings: Sequence[Recording], policies: Sequence[str]) -> list[Pair]:
    """(policy, its recordings, all others) of the policies with most seconds; fits cost time."""
    lengths = {name: sum(one.seconds for one in recordings if one.policy_hash == name) for name in policies}
    longest = sorted(policies, key=lambda name: (-lengths[name], name))[:MOST_FITS]
    return [
        (
            name,
            [one for one in recordings if one.policy_hash == name],
            [one for one in recordings if one.policy_hash != name],
        )
        for name in longest
    ]


def _by_time(recordings: Sequence[Recording]) -> list[Pair]:
    """The last part of each recording against the beginnings."""
    last, first = [], []
    for one in recordings:
        stop = round(one.num_samples * (1 - HELD_OUT_SHARE))
        if min(stop, one.num_samples - stop) >= 2:
            first.append(named_part(one, 0, stop))
            last.append(named_part(one, stop, one.num_samples))
    return [(recordings[0].policy_hash, last, first)] if first else []


def _held_out(objective: Objective, signals: Signals, pairs: Sequence[Pair]) -> tuple[list[HeldOut], float | None]:
    found: list[HeldOut] = []
    everything: list[Trace] = []
    for name, test, training in pairs:
        model = Linear(LinearSettings(), signals)
        what = f"Measurement model 'linear', fitted with policy {name[:8] or '(unnamed)'} held out,"
        guarded(what, partial(model.fit, training))
        traces = [trace for trace in traces_of(model, objective.target.name, test) if len(trace.measured)]
        if not traces:
            continue
        everything += traces
        measured = np.concatenate([trace.measured for trace in traces])
        predicted = np.concatenate([trace.predicted for trace in traces])
        error = float(predicted.mean() - measured.mean())
        seconds = sum(one.seconds for one in test)
        found.append(HeldOut(name, seconds, float(measured.mean()), error, r2(measured, predicted)))
    return found, pooled_r2(everything)


def _too_little(seconds: float, policies: Sequence[str]) -> list[str]:
    found = []
    if seconds < LEAST_SECONDS:
        found.append(
            f"record {LEAST_SECONDS - seconds:.0f} s more: there are {seconds:.0f} s, expected {LEAST_SECONDS:g}"
        )
    if len(policies) < LEAST_POLICIES:
        there = "no policy is named (policy_hash in the mapping)" if policies == [""] else f"there are {len(policies)}"
        found.append(
            f"record other policies, {LEAST_POLICIES} at least: {there}, so nothing shows how wrong a model is about a "
            "policy that it has not seen"
        )
    return found


def _at_speeds(speeds: Sequence[float], at: dict[float, float], unstated: float) -> tuple[list[str], list[str]]:
    """What is missing at the speeds that are asked about, and what cannot be said of them: where that many seconds are
    of recordings without speeds, they may be there."""
    missing, unsaid = [], []
    for speed in speeds:
        there = sum(one for known, one in at.items() if abs(known - speed) < SAME_SPEED)
        if there >= SECONDS_AT_A_SPEED:
            continue
        if there + unstated >= SECONDS_AT_A_SPEED:
            unsaid.append(
                f"whether there are {SECONDS_AT_A_SPEED:g} s at {speed:g}: {unstated:.0f} s are of recordings that "
                "state no commanded speed. State it (recording.schedule in the mapping), or ask without --speed"
            )
        else:
            missing.append(
                f"record {SECONDS_AT_A_SPEED - there:.0f} s more at {speed:g}: there are {there:.0f} s, expected "
                f"{SECONDS_AT_A_SPEED:g}"
            )
    return missing, unsaid


def _too_alike(directions: int, inputs: int) -> list[str]:
    if not inputs or directions >= LEAST_DIRECTIONS * inputs:
        return []
    line = (
        f"record with exploration noise: 95 % of how the {inputs} inputs move lies along {directions} directions, "
        f"expected {np.ceil(LEAST_DIRECTIONS * inputs):.0f}; one gait does not tell joints apart"
    )
    return [line]


def _too_wrong(held_out: Sequence[HeldOut], found: float | None, by_policy: bool, unit: str) -> list[str]:
    what = "policies it had not seen" if by_policy else "the last part of each recording"
    if found is None:
        return ["record longer: too little is left to test a model on"]
    lines = []
    if found < LEAST_R2:
        lines.append(
            f"the model explains {found:.2f} of the variance of {what}, expected {LEAST_R2:g}: record more like them"
        )
    if by_policy and len(held_out) > 1:
        levels = np.array([one.measured for one in held_out])
        worst = max(held_out, key=lambda one: abs(one.mean_error))
        spread = float(levels.max() - levels.min())
        if abs(worst.mean_error) > 0.5 * spread:
            lines.append(
                f"the level of policy {worst.policy[:8] or '(unnamed)'} is missed by {worst.mean_error:+.3g} {unit}, "
                f"more than half of what policies differ by ({spread:.3g} {unit}): record policies that differ more, "
                "or longer"
            )
    return lines
