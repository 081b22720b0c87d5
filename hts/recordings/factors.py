"""What a mapping multiplies columns by: `sign` and `scale`, one number for a channel or of each joint."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from hts.recordings.mapping import ChannelMapping


def common_factor(one: ChannelMapping) -> float:
    """sign · scale, as far as they are one number for all components of the channel."""
    return (1 if isinstance(one.sign, dict) else one.sign) * (1.0 if isinstance(one.scale, dict) else one.scale)


def has_factors_of_joints(one: ChannelMapping) -> bool:
    """Whether sign or scale is said of single joints."""
    return isinstance(one.sign, dict) or isinstance(one.scale, dict)


def times_factors_of_joints(values: np.ndarray, one: ChannelMapping, joints: Sequence[str]) -> np.ndarray:
    """Columns (rows, J), in the order of the robot's joints, times what is said of each; joints that are not named
    stay as they are."""
    for said in (one.sign, one.scale):
        if isinstance(said, dict):
            values = values * np.array([said.get(joint, 1) for joint in joints], dtype=np.float64)
    return values
