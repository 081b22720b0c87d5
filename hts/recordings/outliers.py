"""Single rows that no machine makes, left out and counted where the mapping says so."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from hts import units
from hts.contracts import Robot
from hts.errors import ConfigError, RecordingError
from hts.recordings.factors import common_factor, common_offset
from hts.recordings.mapping import ChannelMapping, follows_joints
from hts.recordings.plausible import ABSURD_FACTOR

MOST_DROPPED = 0.01
"""Share of rows that may be dropped; more is no outlier."""


def outlier_limits(name: str, one: ChannelMapping, robot: Robot) -> tuple[np.ndarray, np.ndarray] | None:
    """Lowest and highest value of each component, (k,) or (), in the mapping's unit; None where nothing is dropped.

    Without stated limits they are what no machine like the robot can do: `ABSURD_FACTOR` times its own. Raises
    ConfigError where the robot has no limit for the quantity.
    """
    if one.outside == "refuse":
        return None
    if one.limits is not None:
        return np.asarray(one.limits[0]), np.asarray(one.limits[1])
    spec, own = robot.spec, robot.channels().get(name)
    known = {"N*m": spec.torque_limit, "rad/s": spec.velocity_limit}
    if own is None or not follows_joints(name, one) or (own.unit not in known and name != "joint_position"):
        raise ConfigError(
            f"Mapping: channel '{name}': `outside: drop` needs `limits`; the robot's own are those of joint torques, "
            "velocities and positions."
        )
    low, high = np.asarray(spec.position_limit).T if own.unit not in known else (0.0, 0.0)
    reach = (high - low) / 2 if own.unit not in known else np.asarray(known[own.unit])
    scale, offset = units.conversion(own.unit, one.unit)
    middle = (low + high) / 2
    one_end, other_end = (scale * (middle + sign * ABSURD_FACTOR * reach) + offset for sign in (-1, 1))
    return np.minimum(one_end, other_end), np.maximum(one_end, other_end)


def without_outliers(
    name: str, values: np.ndarray, one: ChannelMapping, limits: tuple[np.ndarray, np.ndarray] | None, path: Path
) -> tuple[np.ndarray, int]:
    """Values (rows, k), NaN outside the limits, and in how many rows that was. Raises RecordingError for many."""
    if limits is None:
        return values, 0
    low, high = limits
    given = common_factor(one) * values + common_offset(one)
    outside: np.ndarray = (given < low) | (given > high)
    wrong: np.ndarray = np.any(outside, axis=1)
    if wrong.mean() > MOST_DROPPED:
        raise RecordingError(
            f"{path}: '{name}' lies outside {np.min(low):g} to {np.max(high):g} {one.unit} in {wrong.sum()} of "
            f"{len(wrong)} rows; at most {MOST_DROPPED:.0%} are dropped. Correct the limits, or the column."
        )
    return np.where(outside, np.nan, values), int(wrong.sum())
