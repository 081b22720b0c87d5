"""Whether columns can be what a mapping says they are, judged by the robot's limits.

Logs exist whose header says torque over columns that hold motor temperatures. Units do not show that; limits do.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from hts.contracts import RobotSpec
from hts.recordings.recording import Series

# A log may overshoot a limit for a moment (estimates, impacts). It may not do so typically, nor by half in 1 % of it.
PEAK_FACTOR = 1.5
PEAK_SHARE = 0.01
# Encoder zeros and soft stops: a position may lie this far outside its range, rad.
POSITION_MARGIN = 0.35


def implausible(channels: Mapping[str, Series], per_joint: Mapping[str, bool], spec: RobotSpec) -> list[str]:
    """What cannot be true, one phrase per channel. per_joint: whether a channel follows the robot's joints."""
    found = []
    for name, series in channels.items():
        if not per_joint[name]:
            continue
        unit = series.channel.unit
        if unit == "N*m":
            limits = np.asarray(spec.torque_limit)
        elif unit == "rad/s":
            limits = np.asarray(spec.velocity_limit)
        elif name == "joint_position":
            low, high = np.asarray(spec.position_limit).T
            middle, limits = (low + high) / 2, (high - low) / 2 + POSITION_MARGIN
            found += _beyond(name, unit, series.values, series.values - middle, limits, spec.joint_names)
            continue
        else:
            continue
        found += _beyond(name, unit, series.values, series.values, limits, spec.joint_names)
    return found


def outside(name: str, series: Series, limits: tuple[float, float]) -> list[str]:
    """A phrase if any sample lies outside limits that the mapping states."""
    low, high = limits
    values = series.values
    wrong = (values < low) | (values > high)
    if not wrong.any():
        return []
    return [
        (
            f"'{name}' runs from {values.min():g} to {values.max():g} {series.channel.unit}, "
            f"the mapping allows {low:g} to {high:g}"
        )
    ]


def _beyond(
    name: str, unit: str, shown: np.ndarray, centred: np.ndarray, limits: np.ndarray, joint_names: tuple[str, ...]
) -> list[str]:
    """shown, centred: (T, J); limits: (J,) largest |centred|."""
    size = np.abs(centred)
    typical = np.median(size, axis=0) > limits
    peaks = (size > PEAK_FACTOR * limits).mean(axis=0) > PEAK_SHARE
    bad = np.flatnonzero(typical | peaks)
    if not len(bad):
        return []
    worst = int(bad[np.argmax((np.median(size, axis=0) / limits)[bad])])
    column = shown[:, worst]
    phrase = (
        f"'{name}' of {joint_names[worst]} runs from {column.min():g} to {column.max():g} {unit}, "
        f"beyond its limit ({limits[worst]:g})"
    )
    if len(bad) > 1:
        phrase += f", and {len(bad) - 1} more joint{'s' if len(bad) > 2 else ''} likewise"
    # Nearly all: where a whole number changes, resampling leaves a few values in between.
    if (shown == np.round(shown)).mean() > 0.9 and np.all(np.ptp(shown, axis=0) <= 5) and np.all(shown >= 0):
        phrase += "; whole numbers that hardly change, as temperatures do"
    return [phrase]
