"""Whether joint velocities are those of the joint positions: columns that are swapped, in another order, sign or unit.

Limits do not show that. The slope of the positions does: on public logs of a walking quadruped it correlates with the
velocity by 0.71 to 0.99 for each joint at 50 Hz, with a ratio of 1.0 to 1.4. Only what lies far from that is refused.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping

import numpy as np

from hts.contracts import RobotSpec
from hts.errors import RecordingError
from hts.recordings.recording import Series

MOVING = 0.1
"""rad/s of standard deviation, of slope and of velocity: a joint that moves less tells nothing."""
LEAST_SAMPLES = 50
UNLIKE, ALIKE, SURE = 0.3, 0.7, 0.9
BETTER = 0.15
"""By so much another joint's velocity must fit a joint's positions better than its own does. In public logs of a
walking quadruped (tests/recordings/test_real_logs.py) that of the other side fits by up to 0.96, by 0.06 better at
most."""
OTHER_UNIT = 5.0
"""Ratio of velocity to slope, either way; degrees are 57, turns a minute 9.5."""
MOST_FAST = 0.5
"""Share of squares above a quarter of the rate from which on the samples do not tell how fast something changes."""


def check_motion(
    channels: Mapping[str, Series], spec: RobotSpec, rate_hz: float, where: str, stated: Collection[str] = ()
) -> None:
    """Raise RecordingError where `joint_velocity` is not the slope of `joint_position`, saying what it looks like.

    rate_hz: of the samples; stated: names of channels whose limits a mapping states, which is a person's word for them.
    """
    names = ("joint_position", "joint_velocity")
    if any(name not in channels or name in stated for name in names):
        return
    position, velocity = (channels[name].values.astype(np.float64) for name in names)
    if len(position) < LEAST_SAMPLES or position.ndim != 2 or position.shape != velocity.shape:
        return
    slope = np.gradient(position, 1.0 / rate_hz, axis=0)
    moving = np.flatnonzero((slope.std(0) > MOVING) & (velocity.std(0) > MOVING))
    if not len(moving):
        _check_unit(slope, velocity, where)
        return
    (slopes, slope_spread), (speeds, speed_spread) = standardized(slope[:, moving]), standardized(velocity[:, moving])
    alike = slopes.T @ speeds / len(position)  # [position's joint, velocity's joint]
    own, ratio = np.median(np.diag(alike)), float(np.median(speed_spread / slope_spread))
    names_of_moving = [spec.joint_names[joint] for joint in moving]
    hint = _another_order(alike, names_of_moving, own)
    each = np.diag(alike)
    against = each < -SURE
    if hint:  # first: in a trot a leg moves against the one on the other side, as if it were counted the other way
        pass
    elif against.any() and not against.all() and (each[~against] > ALIKE).all():
        turned = [names_of_moving[joint] for joint in np.flatnonzero(against)]
        said = ", ".join(f"{name}: -1" for name in turned)
        hint = f"of {', '.join(turned)} alone one of them is counted the other way: say sign: {{{said}}}"
        hint += _or_another_order(alike, np.flatnonzero(against))
    elif own < -SURE:
        hint = "one of them is counted the other way: say sign: -1" + _or_another_order(alike)
    elif own < -ALIKE:
        hint = (
            "they go against each other, but not as closely as one that is only counted the other way (-1): look at "
            "the order of the columns first, then at their sign"
        )
    elif own < UNLIKE:
        hint = "the columns are probably others than the mapping says"
    elif own > ALIKE and not 1 / OTHER_UNIT < ratio < OTHER_UNIT:
        hint = f"it is {ratio:.3g} times the slope of the positions: one of them is in another unit"
    if hint:
        raise RecordingError(
            f"{where}: 'joint_velocity' is not how fast 'joint_position' changes (correlation {own:.2f} for the joint "
            f"in the middle): {hint}. Correct the mapping; if both are right, say so with `limits`."
        )


def _check_unit(slope: np.ndarray, velocity: np.ndarray, where: str) -> None:
    """Raise RecordingError where no joint moves by both, but by one of them, and the two go together as if one were in
    another unit: of a slow arm, turns a minute that are taken for rad/s are below MOVING. (T, J) each, rad/s."""
    if max(share_of_fast(slope), share_of_fast(velocity)) > MOST_FAST:  # slopes of samples are too small then
        return
    one_moves = np.maximum(slope.std(0), velocity.std(0)) > MOVING
    joints = np.flatnonzero(one_moves & (np.minimum(slope.std(0), velocity.std(0)) > 0))
    if not len(joints):
        return
    alike = float(np.median(correlations(slope[:, joints], velocity[:, joints])))
    ratio = float(np.median(velocity[:, joints].std(0) / slope[:, joints].std(0)))
    if abs(alike) > SURE and not 1 / OTHER_UNIT < ratio < OTHER_UNIT:
        raise RecordingError(
            f"{where}: 'joint_velocity' is not how fast 'joint_position' changes: it is {ratio:.3g} times the slope of "
            "the positions, so one of them is in another unit. Correct the mapping; if both are right, say so with "
            "`limits`."
        )


def share_of_fast(values: np.ndarray) -> float:
    """Share of the squares above a quarter of the rate, of the column of (T, C) where it is largest; 0 of none that
    changes. What is faster than half of the rate is folded to there."""
    squares = np.abs(np.fft.rfft(values - values.mean(axis=0), axis=0)) ** 2
    above, whole = np.fft.rfftfreq(len(values)) > 1 / 4, squares.sum(axis=0)  # periods a sample
    return float(np.divide(squares[above].sum(axis=0), whole, out=np.zeros_like(whole), where=whole > 0).max())


def standardized(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Of mean 0 and deviation 1, (T, k), and the deviations, (k,)."""
    spread = values.std(0)
    return (values - values.mean(0)) / spread, spread


def correlations(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """(k,), of each column with the other's, (T, k) each; 0 of a column that stays as it is."""
    one, other = one - one.mean(axis=0), other - other.mean(axis=0)
    return np.asarray((one * other).mean(axis=0) / np.maximum(one.std(axis=0) * other.std(axis=0), 1e-12))


def exchanged(alike: np.ndarray, least: float) -> tuple[np.ndarray, np.ndarray]:
    """Joints (m,) that fit another one's quantity by more than `least`, either way, and by BETTER more than their own;
    and whose each joint fits best, (k,). alike: (k, k) correlations [one's joint, the other's joint]."""
    size, at = np.abs(alike), np.arange(len(alike))
    best = size.argmax(axis=1)
    return np.flatnonzero((size[at, best] > least) & (size[at, best] > size[at, at] + BETTER)), best


def _another_order(alike: np.ndarray, joints: list[str], own: float) -> str:
    """What to say where joints fit each other's velocities much better than their own; "" elsewhere.

    alike: (k, k) correlations [position's joint, velocity's joint]; own: of a joint with itself, the one in the middle.
    Where that is near 0 one joint is enough; else those that fit better must have each taken another's place.
    """
    moved, best = exchanged(alike, SURE if own >= UNLIKE else ALIKE)
    if not len(moved) or (abs(own) >= UNLIKE and sorted(best[moved]) != moved.tolist()):
        return ""
    first, other = moved[0], best[moved[0]]
    found = float(alike[first, other])
    turned = ", counted the other way (correct the order first, then the sign)" if found < 0 else ""
    return (
        f"the position of {joints[first]} moves as the velocity of {joints[other]} says ({found:.2f}){turned}, so they "
        "are in different joint orders"
    )


def _or_another_order(alike: np.ndarray, joints: np.ndarray | None = None) -> str:
    """A warning where another order of the columns would explain a log that looks as if it were counted the other way,
    since legs that move against each other look so too. joints: which look so, all of them where it is None."""
    others = np.where(np.eye(len(alike), dtype=np.bool_), -1.0, alike).max(axis=1)
    others = others if joints is None else others[joints]
    if np.median(others) < SURE:
        return ""
    return (
        f"; or columns of left and right are swapped, which fits as well ({np.median(others):.2f}), so look at the "
        "order first"
    )
