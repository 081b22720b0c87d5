"""What a mapping makes of columns: value = sign · scale · column + offset, each one number for a channel or of single
joints."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from hts.recordings.mapping import ChannelMapping


def common_factor(one: ChannelMapping) -> float:
    """sign · scale, as far as they are one number for all components and `of_joints` has not had a part in it."""
    return 1.0 if isinstance(one.offset, dict) else _common(one)


def common_offset(one: ChannelMapping) -> float:
    """The offset where it is one number for all components."""
    return 0.0 if isinstance(one.offset, dict) else one.offset


def names_joints(one: ChannelMapping) -> bool:
    """Whether sign, scale or offset is said of single joints."""
    return any(isinstance(said, dict) for said in (one.sign, one.scale, one.offset))


def of_joints(values: np.ndarray, one: ChannelMapping, joints: Sequence[str]) -> np.ndarray:
    """Columns (rows, J), in the order of the robot's joints, with what is said of each; joints that are not named
    stay as they are. An offset comes after all factors, so with one of single joints the common factor is in it."""
    for said in (one.sign, one.scale):
        if isinstance(said, dict):
            values = values * np.array([said.get(joint, 1) for joint in joints], dtype=np.float64)
    if isinstance(one.offset, dict):
        values = _common(one) * values + np.array([one.offset.get(joint, 0.0) for joint in joints], dtype=np.float64)
    return values


def as_one(values: np.ndarray, one: ChannelMapping) -> np.ndarray:
    """Columns (rows, J) as one, (rows, 1), where the mapping asks for their sum or the largest of them; NaN where one
    of them is. The largest is that of the values: with a factor below 0 it is the smallest of the columns."""
    if one.sum:
        return values.sum(axis=1, keepdims=True)
    if one.max:
        return (values.min if common_factor(one) < 0 else values.max)(axis=1, keepdims=True)
    return values


def _common(one: ChannelMapping) -> float:
    return (1 if isinstance(one.sign, dict) else one.sign) * (1.0 if isinstance(one.scale, dict) else one.scale)
