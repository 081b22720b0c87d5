"""Targets that are not those of a contract: which other order, scale or pose makes them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

TARGET_TOLERANCE = 1e-4  # rad: float32 of an angle, and of the sum that makes it


def told_apart(found: float, said: float) -> tuple[str, str]:
    """Two numbers with four digits, or as many more as it takes to tell one from the other."""
    shown = ((f"{found:.{digits}g}", f"{said:.{digits}g}") for digits in range(4, 17))
    return next((pair for pair in shown if pair[0] != pair[1]), (f"{found:.17g}", f"{said:.17g}"))


def explained(names: Sequence[str], pose: np.ndarray, scale: np.ndarray, action: np.ndarray, target: np.ndarray) -> str:
    """In words, what of the contract is wrong if targets (n, J) follow actions (n, J), one by one, by another order,
    scale or pose; empty if they do not. names, pose rad, scale rad per unit: the contract's, in its order."""
    count = len(names)
    slope, level, best = np.empty(count), np.empty(count), np.empty(count, int)
    centred = action - action.mean(0)
    for joint in range(count):
        wanted = target[:, joint] - target[:, joint].mean()
        slopes = (centred * wanted[:, None]).sum(0) / np.square(centred).sum(0)
        left = np.abs(wanted[:, None] - slopes * centred).max(0)
        best[joint] = int(left.argmin())
        if left[best[joint]] > TARGET_TOLERANCE:
            return ""
        slope[joint] = slopes[best[joint]]
        level[joint] = target[:, joint].mean() - slope[joint] * action[:, best[joint]].mean()
    for joint, name in enumerate(names):
        if best[joint] != joint:
            order = [""] * count
            for other, which in enumerate(best):
                order[which] = names[other]
            return (
                f"joint_order is another: {name}'s target follows action {best[joint]}, the contract says {joint}. By "
                f"the log it is {', '.join(order)}"
            )
    for joint, name in enumerate(names):
        if abs(slope[joint] - scale[joint]) * np.abs(action[:, joint]).max() > TARGET_TOLERANCE:
            found, said = told_apart(slope[joint], scale[joint])
            return f"action_scale of {name} is {found} rad by the log's targets, the contract says {said}"
    joint = int(np.abs(level - pose).argmax())
    found, said = told_apart(level[joint], pose[joint])
    return f"default_pose of {names[joint]} is {found} rad by the log's targets, the contract says {said}"
