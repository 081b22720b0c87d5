"""Whether joint torques are those that the joint controllers ask for: other signs, orders of joints, units, late ones.

A joint controller with proportional and derivative gains gives tau = kp (q* - q) - kd q', so a log that has targets q*,
positions, velocities and torques says itself whether its torques can be right. What is asked for is held against what
was measured by the correlation of what is left of both when their mean over one second was taken off: a robot that is
let go drifts for seconds, with torques that nobody asked for.

Where the numbers come from: on a public log of a walking quadruped (tests/recordings/test_real_logs.py; it stands for
5 s, walks for 4 s and is let go for 6 s) the correlation is 0.88 in the middle and 0.72 for the worst joint, and no
other joint's torque fits a joint better than its own; over the six seconds alone it is 0.78 and 0.32. On the default
simulated robot and 26 drawn ones, told 0 to 1 m/s for 18 s, it is at least 0.80 in the middle and 0.60 for the worst
joint, and with the sign changed at most 0.33 at the lags that are best for it.

Torques that are late by half of a stride look as if they were counted the other way, or as those of the other side.
What fits better is right. Of 68 walks of the default simulated robot and drawn ones, 6 to 80 s at one speed or several,
each joint's own torque fitted with 0.98 or more at the lag that it was late by (140 to 200 ms), and what it looked like
with at most 0.95 of that. Of the same walks with left and right swapped a lag fitted with at most 0.86 of what the
other side's torque did, and with the sign changed with at most 0.88. A whole stride more or less fits nearly as well.
"""

from __future__ import annotations

import itertools
from collections.abc import Collection
from typing import NamedTuple

import numpy as np

from hts.contracts import RobotSpec
from hts.errors import RecordingError
from hts.recordings.motion import ALIKE, SURE, UNLIKE, exchanged, standardized
from hts.recordings.recording import Recording

NAMES = ("joint_target", "joint_position", "joint_velocity", "joint_torque")
SLOW_SECONDS = 1.0
"""The mean over so long is taken off."""
LEAST_SECONDS = 3.0
TARGET_LAGS, TORQUE_LAGS = np.arange(-1, 4) * 0.02, np.arange(-1, 3) * 0.02
"""s: how much later than logged a target acts, and a torque shows; all pairs are tried. A target that is logged with
the state it was computed from acts one sample later."""
LATE_LAGS = np.arange(-15, 16) * 0.02
"""s: the lags of torques at which lateness is looked for, half a stride and more either way."""
CLEARLY = 0.96
"""One explanation is clearly better where the other one's correlation is below this share of its own."""
EITHER = 0.5
"""What fits its own joint so well at some lags is not refused for its sign at others."""
ASKED = 0.02
"""Standard deviation of what is asked of a joint, as a share of its torque limit: with less it tells nothing."""
FAR = 3.0
"""Ratio of measured to asked torque, either way, from which on it is told: gear ratios are 6 and more. Firmware that
has other gains than stated is rarely that far off: with gains of 20 to 60 N*m/rad the log above has 1.7 to 0.5."""


class _Fit(NamedTuple):
    """At one pair of lags: correlations (k, k) [asked of joint, measured of joint], measured over asked size (k,)."""

    alike: np.ndarray
    ratio: np.ndarray

    @property
    def own(self) -> float:
        """Of a joint with itself, the one in the middle."""
        return float(np.median(np.diag(self.alike)))

    @property
    def any(self) -> float:
        """Of a joint with whichever it fits best, either way, the one in the middle."""
        return float(np.median(np.abs(self.alike).max(axis=1)))


def torque_notes(recording: Recording, spec: RobotSpec, where: str, stated: Collection[str] = ()) -> dict[str, str]:
    """Notes where `joint_torque` is not what kp (target - position) - kd velocity asks for, but may be right.

    where: begins messages; stated: names of channels whose limits a mapping states, which is a person's word for them.
    Raises RecordingError where it is that of other joints or counted the other way. Nothing is said of a log without
    one of the four channels, without gains, or whose joints are asked for too little.
    """
    channels = recording.channels
    if "joint_torque" in stated or any(name not in channels for name in NAMES):
        return {}
    values = [channels[name].values.astype(np.float64) for name in NAMES]
    seconds = len(values[0]) / recording.rate_hz
    if seconds < LEAST_SECONDS or any(one.shape != (len(values[0]), spec.num_joints) for one in values):
        return {}
    limit = np.asarray(spec.torque_limit)
    joints, fits = _fits(values, recording, limit, TORQUE_LAGS)
    if not fits:
        return {}
    names = [spec.joint_names[joint] for joint in joints]
    best = max(fits, key=lambda fit: fit.own)
    fit = best if best.own > ALIKE else max(fits, key=lambda one: one.any)
    hint = _refused(fit, best, names)
    late = _late(values, recording, limit) if hint or best.own < UNLIKE else None
    if late is not None and late.own * CLEARLY > (fit.any if hint else 0.0):
        return {
            "joint_torque_late": (
                f"{late.told} than what kp (target - position) - kd velocity asks for (correlation {late.own:.2f}; "
                f"{best.own:.2f} without that): are their stamps of different clocks, or is one of them filtered?"
            )
        }
    if hint:
        if late is not None and late.own > CLEARLY * fit.any:
            also = f"it is {late.told} than what they give, which fits as well ({late.own:.2f})"
            hint += f"; or {also}, so look at the stamps first"
        raise RecordingError(
            f"{where}: 'joint_torque' is not what the joint controllers give, kp (target - position) - kd velocity "
            f"(correlation {fit.own:.2f} for the joint in the middle): {hint}. Correct the mapping or the log; if it "
            "is right, say so with `limits`."
        )
    ratio = float(np.median(best.ratio))
    if best.own > ALIKE and not 1 / FAR < ratio < FAR:
        return {
            "joint_torque_scale": (
                f"{ratio:.2g} times what kp (target - position) - kd velocity asks for: is it of the motor's side of "
                "the gears, or in A? Or are kp and kd others than stated?"
            )
        }
    if best.own < UNLIKE:
        return {
            "joint_torque_unlike": (
                f"hardly what kp (target - position) - kd velocity asks for (correlation {best.own:.2f}): are these "
                "the torques, and the targets?"
            )
        }
    return {}


def _refused(fit: _Fit, best: _Fit, names: list[str]) -> str:
    """What torques look like that cannot be right; "" for others. best: at the lags where own joints fit best."""
    for least, share in ((SURE, 0.0), (ALIKE, 0.5)):  # a few joints must fit very well, half of them or more well
        moved, others = exchanged(fit.alike, least)
        if len(moved) and len(moved) >= share * len(names) and sorted(others[moved]) == moved.tolist():
            first, other = moved[0], others[moved[0]]
            found = float(fit.alike[first, other])
            turned = ", counted the other way (correct the order first, then the sign)" if found < 0 else ""
            return (
                f"what is asked of {names[first]} is measured of {names[other]} ({found:.2f}){turned}, so they are in "
                "different joint orders"
            )
    own = np.diag(fit.alike)
    unsure = "; some fit other joints better, so look at the order first" if len(exchanged(fit.alike, ALIKE)[0]) else ""
    if fit.own < -ALIKE and best.own < EITHER:
        return f"it is counted the other way: say sign: -1{unsure}"
    against = np.flatnonzero(own < -ALIKE)
    if fit.own > ALIKE and len(against):
        first, more = against[0], f", as of {len(against) - 1} more" if len(against) > 1 else ""
        signs = ", ".join(f"{names[joint]}: -1" for joint in against)
        return (
            f"that of {names[first]} is counted the other way ({own[first]:.2f}){more}, others are not: say sign: "
            f"{{{signs}}}{unsure}"
        )
    return ""


class _Late(NamedTuple):
    """own: as of `_Fit`, where torques are moved by `seconds`, the lag that fits best."""

    seconds: float
    own: float

    @property
    def told(self) -> str:
        return f"about {1000 * abs(self.seconds):.0f} ms {'later' if self.seconds > 0 else 'earlier'}"


def _late(values: list[np.ndarray], recording: Recording, limit: np.ndarray) -> _Late | None:
    """Torques that are those of their own joints at a lag beyond TORQUE_LAGS; None where that is not so."""
    found = []
    for samples in np.unique(np.rint(LATE_LAGS * recording.rate_hz)):
        seconds = float(samples / recording.rate_hz)
        _, fits = _fits(values, recording, limit, np.array([seconds]))
        found += [_Late(seconds, fit.own) for fit in fits]
    best = max(found, key=lambda one: one.own, default=None)
    if best is None or best.own < ALIKE or TORQUE_LAGS[0] <= best.seconds <= TORQUE_LAGS[-1]:
        return None
    return best


def _fits(
    values: list[np.ndarray], recording: Recording, limit: np.ndarray, lags: np.ndarray
) -> tuple[np.ndarray, list[_Fit]]:
    """Joints (k,) that are asked for enough to tell, and a fit for each pair of lags; none where there are none. lags:
    of the torques, s."""
    target, position, velocity, torque = values
    rate = recording.rate_hz
    kp, kd = np.asarray(recording.kp), np.asarray(recording.kd)
    target_lags, torque_lags = (np.unique(np.rint(one * rate).astype(int)) for one in (TARGET_LAGS, lags))
    edge = int(np.abs(target_lags).max() + np.abs(torque_lags).max())
    rows = np.arange(edge, len(target) - edge)
    window = max(round(SLOW_SECONDS * rate), 3)
    asked = [
        _fast(np.clip(kp * (target[rows - lag] - position[rows]) - kd * velocity[rows], -limit, limit), window)
        for lag in target_lags
    ]
    given = [_fast(torque[rows + lag], window) for lag in torque_lags]
    moving = np.logical_and.reduce([one.std(0) > ASKED * limit for one in asked] + [one.std(0) > 0 for one in given])
    joints = np.flatnonzero(moving)
    if not len(joints):
        return joints, []
    fits = []
    for wanted, seen in itertools.product(asked, given):
        (one, size), (other, other_size) = standardized(wanted[:, joints]), standardized(seen[:, joints])
        fits.append(_Fit(one.T @ other / len(rows), other_size / size))
    return joints, fits


def _fast(values: np.ndarray, window: int) -> np.ndarray:
    """Values (T, J) minus their mean over the window around each, in samples; shorter at both ends."""
    sums = np.concatenate([np.zeros((1, values.shape[1])), np.cumsum(values, axis=0)])
    at = np.arange(len(values))
    first, last = np.maximum(at - window // 2, 0), np.minimum(at + window - window // 2, len(values))
    return values - (sums[last] - sums[first]) / (last - first)[:, None]
