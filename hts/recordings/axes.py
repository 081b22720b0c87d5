"""Which axes a gyroscope has: x and y exchanged, another axis in the place of one, the whole of it turned about z, or
the axes of the world, which the trunk turns away from.

Gravity in the trunk's frame turns as the trunk does (`turning`), so the gyroscope, read along the axes that it really
has, explains how gravity turns, and read along others it does not. As there, no delay of up to 0.3 s may explain it.

Six walks each of the default simulated robot and of 16 drawn ones, and two public logs of a walking quadruped, are
explained by no other reading as they are. With x and y exchanged four walks in ten are found: of the others the
attitude is too noisy, or the robot stands.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from itertools import permutations, product

import numpy as np

from hts.recordings.motion import ALIKE
from hts.recordings.recording import Series
from hts.recordings.turning import at_best, turn_of

CLEARLY = 0.3
"""By so much the component that fits worse must fit better than it does as it is, at the best delay of both."""
AS_GOOD = 0.02
"""Among readings that fit alike the simpler one, which comes first, is told."""
TURNED = np.radians(np.arange(45.0, 316.0, 22.5))
"""Angles that are tried."""
TURNS_AWAY = 1.0
"""rad by which the heading must change, or the world's axes are the trunk's."""


def axes_notes(channels: Mapping[str, Series], rate_hz: float, stated: Collection[str] = ()) -> dict[str, str]:
    """A note where a gyroscope explains how gravity turns only if it is read along other axes. It is no more than that:
    roll and pitch of a gait have one rhythm, and an attitude that takes accelerations for gravity can look so too.

    rate_hz: of the samples; stated: names of channels whose limits a mapping states, which is a person's word for them.
    """
    found = turn_of(channels, rate_hz, stated)
    if found is None:
        return {}

    def fits(read: np.ndarray) -> float:
        told = np.cross(found.gravity, read)[:, :2]
        return at_best(found.seen, told, rate_hz) if told.std(axis=0).min() > 0 else -1.0

    own = fits(found.velocity)
    if not own + CLEARLY <= 1.0:
        return {}
    best, told = own + CLEARLY, None
    for read, words in _readings(found.velocity, rate_hz):
        like = fits(read)
        if like > max(best, ALIKE) and (told is None or like > best + AS_GOOD):
            best, told = like, words
    if told is None:
        return {}
    return {
        "angular_velocity_axes": (
            f"angular_velocity is not how projected_gravity turns in the trunk's frame (correlation "
            f"{found.alike[0]:.2f} and {found.alike[1]:.2f}), and {told} (correlation {best:.2f} then). If it is "
            "right, the attitude is not: accelerations of a gait may have been taken for gravity"
        )
    }


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
