"""Which axes a gyroscope has: x and y exchanged, another axis in the place of one, the whole of it turned about z, or
the axes of the world, which the trunk turns away from.

Gravity in the trunk's frame turns as the trunk does (`turning`), so the gyroscope, read along the axes that it really
has, explains how gravity turns, and read along others it does not. As there, no delay of up to 0.3 s may explain it.

Six walks each of the default simulated robot and of 16 drawn ones, and two public logs of a walking quadruped, are
explained by no other reading as they are. With x and y exchanged four walks in ten are found: of the others the
attitude is too noisy, or the robot stands.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import permutations, product

import numpy as np

from hts.recordings.motion import ALIKE

CLEARLY = 0.3
"""By so much the component that fits worse must fit better than it does as it is, at the best delay of both."""
AS_GOOD = 0.02
"""Among readings that fit alike the simpler one, which comes first, is told."""
TURNED = np.radians(np.arange(45.0, 316.0, 22.5))
"""Angles that are tried."""
TURNS_AWAY = 1.0
"""rad by which the heading must change, or the world's axes are the trunk's."""

Late = Callable[[np.ndarray, np.ndarray], float]


def other_axes(seen: np.ndarray, gravity: np.ndarray, velocity: np.ndarray, rate_hz: float, late: Late) -> str | None:
    """What the axes of an angular velocity look like, and what to do; None where they may be the trunk's, or where
    none explains it.

    seen: how gravity turns along x and y, 1/s, (T, 2); gravity, velocity: unit and rad/s, (T, 3), averaged likewise;
    late: correlation of two of (T, 2) at the best delay, of the component that fits worse.
    """

    def fits(read: np.ndarray) -> float:
        told = np.cross(gravity, read)[:, :2]
        return late(seen, told) if told.std(axis=0).min() > 0 else -1.0

    own = fits(velocity)
    if not own + CLEARLY <= 1.0:
        return None
    best, told = own + CLEARLY, None
    for read, words in _readings(velocity, rate_hz):
        found = fits(read)
        if found > max(best, ALIKE) and (told is None or found > best + AS_GOOD):
            best, told = found, words
    return None if told is None else f"{told} (correlation {best:.2f} then)"


def _readings(velocity: np.ndarray, rate_hz: float) -> Iterator[tuple[np.ndarray, str]]:
    trunk = "expected are the trunk's own axes, x forward, y left, z up"
    for order in permutations(range(3)):
        for signs in product((1.0, -1.0), repeat=2):
            if order != (0, 1, 2):
                shown = [f"{'-' if sign < 0 else ''}{'xyz'[axis]}" for axis, sign in zip(order, signs, strict=False)]
                like = f"its columns look exchanged, x and y being its {shown[0]} and {shown[1]}"
                yield velocity[:, order] * [*signs, 1.0], f"{like}: {trunk}; correct their order, and signs in the log"
    heading = np.cumsum(velocity[:, 2]) / rate_hz
    if np.ptp(heading) > TURNS_AWAY:
        for angle in [0.0, *(np.pi / 8 * np.arange(1, 16))]:
            like = "it looks like that in the axes of the world, which the trunk turns away from"
            yield _turned(velocity, -heading - angle), f"{like}: {trunk}, so turn it into those in the log"
    for angle in TURNED:
        yield (
            _turned(velocity, np.full(len(velocity), -angle)),
            f"it looks turned by about {np.degrees(angle):.0f} degrees about z: {trunk}, so turn it back in the log",
        )


def _turned(velocity: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Velocity (T, 3) turned about z by angles (T,), rad."""
    cos, sin = np.cos(angle), np.sin(angle)
    x, y, z = velocity.T
    return np.stack([cos * x - sin * y, sin * x + cos * y, z], axis=1)
