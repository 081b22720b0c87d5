"""Observations that are not what a layout says: which other order, scale, pose or quantity makes them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from hts.policies.replay_targets import told_apart
from hts.policies.terms import ABSOLUTE

SEEN_TOLERANCE = 1e-4  # of an observation's entry, relative where it is larger than 1
TELLING = 10 * SEEN_TOLERANCE  # an entry that is always smaller agrees with anything
OFFSET = "joint_position_offset"
AXES = ("x", "y", "z")


def relative(found: np.ndarray, wanted: np.ndarray) -> float:
    """The largest difference, relative where the wanted number is larger than 1."""
    return float((np.abs(found - wanted) / np.maximum(np.abs(wanted), 1.0)).max(initial=0.0))


def explained(
    name: str,
    labels: Sequence[str],
    seen: np.ndarray,
    expected: np.ndarray,
    factor: np.ndarray,
    pose: np.ndarray,
    others: Mapping[str, np.ndarray],
) -> str:
    """In words, what of the layout is wrong if a part is exactly something else in the log; empty if it is not.

    name: ours, of the part; labels: of its entries (joints, or axes); seen (n, size): what the network was given;
    expected (n, size): what the layout says; factor (size,): its scale; pose (J,): default pose, rad, in the source's
    order; others: unscaled quantities of the log that another part shows (n, size), by our name.
    """
    if (order := _order(seen, expected)) is not None:
        place = int(np.flatnonzero(order != np.arange(len(order)))[0])
        what = "joint_order is another" if labels != AXES else f"{name} has its axes in another order"
        return (
            f"{what}: entry {place} of {name} is {labels[order[place]]} in the log, the contract says {labels[place]}"
        )
    slope = _slope(seen, expected)
    if slope is not None:
        place = int(np.abs(slope - 1).argmax())
        scale, said = told_apart(slope[place] * factor[place], factor[place])
        turned = f", as if {'it' if slope[place] > 1 else 'the log'} were in degrees" if _degrees(slope[place]) else ""
        sign = ": the sign is another" if math.isclose(slope[place], -1, rel_tol=1e-3) else ""
        return f"the scale of {name} is {scale} by the log ({labels[place]}), the layout says {said}{sign}{turned}"
    if name in (OFFSET, ABSOLUTE):
        apart = seen / factor - expected / factor
        if np.all(np.ptp(apart, axis=0) <= SEEN_TOLERANCE):
            return _counted_from(name, labels, apart.mean(0), pose)
    for other, values in others.items():
        scaled = _slope(seen, values)
        if scaled is not None:
            return f"what the layout calls {name} is {other} in the log, with the scale {scaled[0]:.4g}"
    return ""


def _order(seen: np.ndarray, expected: np.ndarray) -> np.ndarray | None:
    """For each entry the one of expected that it is, if they are the same numbers in another order; joints that stand
    alike have none."""
    off = np.abs(seen[:, :, None] - expected[:, None, :]).max(0)  # (source entry, joint)
    best = off.argmin(1)
    if np.any(off.min(1) > SEEN_TOLERANCE) or len(np.unique(best)) != len(best):
        return None
    return best if np.any(best != np.arange(len(best))) else None


def _slope(seen: np.ndarray, expected: np.ndarray) -> np.ndarray | None:
    """What each entry of expected has to be multiplied by to give seen, if that explains all; 1 where seen is so small
    that anything would."""
    size, tells = np.square(expected).sum(0), np.abs(seen).max(0) > TELLING
    if not tells.any() or np.any(size[tells] == 0):
        return None
    slope = np.where(tells, (seen * expected).sum(0) / np.where(tells, size, 1.0), 1.0)
    return slope if relative(seen, slope * expected) <= SEEN_TOLERANCE else None


def _degrees(slope: float) -> bool:
    return any(math.isclose(slope, one, rel_tol=1e-3) for one in (math.degrees(1), math.radians(1)))


def _counted_from(name: str, labels: Sequence[str], apart: np.ndarray, pose: np.ndarray) -> str:
    """In words, of angles that are off by a constant each, rad."""
    other = ABSOLUTE if name == OFFSET else OFFSET
    if np.allclose(apart, pose if name == OFFSET else -pose, atol=SEEN_TOLERANCE):
        which = "the angles themselves" if name == OFFSET else "distances from the default pose"
        return f"what the layout calls {name} are {which} in the log: call it {other}"
    place = int(np.abs(apart).argmax())
    return (
        f"{name} of {labels[place]} is off by {apart[place]:.4g} rad in the whole log: the policy counts its angles "
        "from another pose than default_pose"
    )
