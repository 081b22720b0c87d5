"""Pareto fronts: which points nothing else beats, in layers, and a few of them that cover the whole.

A point is a tuple of J numbers, larger is better in each. Pure functions of such tuples.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

Point = Sequence[float]


def dominates(a: Point, b: Point) -> bool:
    """a is at least as good as b in every number and better in one. A point with a NaN beats nobody."""
    return all(x >= y for x, y in zip(a, b, strict=True)) and any(x > y for x, y in zip(a, b, strict=True))


def non_dominated(points: Sequence[Point]) -> list[int]:
    """Indices of the points that no other dominates, in the order given. (P, J) -> at most P indices.

    Equal points do not dominate each other: all of them stay. A point with a NaN is on no front: comparisons with NaN
    are false, so that nothing would ever dominate it.
    """
    known = [index for index, point in enumerate(points) if not any(math.isnan(value) for value in point)]
    return [index for index in known if not any(dominates(points[other], points[index]) for other in known)]


def layers(points: Sequence[Point]) -> list[list[int]]:
    """Fronts one behind the other: the non-dominated points, those of the rest, and so on (Deb et al. 2002).

    Points with a NaN are the last layer, whatever else they hold.
    """
    left = [index for index, point in enumerate(points) if not any(math.isnan(value) for value in point)]
    unknown = sorted(set(range(len(points))) - set(left))
    found = []
    while left:
        front = [left[index] for index in non_dominated([points[index] for index in left])]
        found.append(front)
        left = [index for index in left if index not in front]
    return [*found, unknown] if unknown else found


def crowding(points: Sequence[Point]) -> list[float]:
    """How much room each point of a front has: Deb et al. 2002, crowding distance, (P, J) -> P.

    Per number: the distance between the two neighbours as a share of the whole spread, summed. The two ends of each
    number have infinite room. A number in which all points are equal, or that is not finite, gives no room.
    """
    room = [0.0] * len(points)
    for values in zip(*points, strict=True):
        order = sorted(range(len(points)), key=lambda index: values[index])
        spread = values[order[-1]] - values[order[0]]
        if not (math.isfinite(spread) and spread > 0):
            continue
        room[order[0]] = room[order[-1]] = math.inf
        for below, index, above in zip(order, order[1:], order[2:], strict=False):
            room[index] += (values[above] - values[below]) / spread
    return room


def spread(points: Sequence[Point], count: int) -> list[int]:
    """Indices of `count` points of a front that cover it: the most crowded one leaves, again and again.

    Distances are found anew after each, since all points of a dense stretch look crowded at once (Kukkonen and Deb
    2006). One point alone is the most even one. Ties: the later point leaves.
    """
    if count == 1 and len(points) > 1:
        return [most_even(points)]
    chosen = list(range(len(points)))
    while len(chosen) > max(count, 0):
        room = crowding([points[index] for index in chosen])
        crowded = min(range(len(chosen)), key=lambda position: (room[position], -position))
        del chosen[crowded]
    return chosen


def most_even(points: Sequence[Point]) -> int:
    """Index of the point whose worst share (see `shares`) is best; of the numbers in which points differ."""
    told = [column for column in zip(*shares(points), strict=True) if any(column)]  # somebody has all of it
    return max(range(len(points)), key=lambda index: min((column[index] for column in told), default=0.0))


def towards(points: Sequence[Point], direction: Point) -> int:
    """Index of the point that goes furthest in a direction (weights of the numbers, none below 0), by `shares`.

    Ties: the larger sum of shares, then the earlier point.
    """
    parts = shares(points)

    def rank(index: int) -> tuple[float, float]:
        return sum(w * part for w, part in zip(direction, parts[index], strict=True)), sum(parts[index])

    return max(range(len(points)), key=rank)


def shares(points: Sequence[Point]) -> list[list[float]]:
    """Each number as a share of its range among the points, 0 the lowest and 1 the highest: units do not matter.

    Numbers in which all points are equal, or that are not all finite, are left out by being 0 for every point.
    """
    ranges = [(min(values), max(values)) for values in zip(*points, strict=True)]
    return [
        [
            (value - low) / (high - low) if high > low and math.isfinite(high - low) else 0.0
            for value, (low, high) in zip(point, ranges, strict=True)
        ]
        for point in points
    ]


def gain_product(gains: Point, weights: Point | None = None) -> float:
    """Product of the gains over the reference, each to the power of its weight (default 1): Nash 1950, Kalai 1977.

    Units cancel: another unit scales all products alike. Zero unless every gain with a weight above zero is above
    zero: whoever is worse in one thing has no claim. NaN counts as no gain.
    """
    weights = weights or [1.0] * len(gains)
    counted = [(gain, weight) for gain, weight in zip(gains, weights, strict=True) if weight > 0]
    if not counted or not all(gain > 0 for gain, _ in counted):
        return 0.0
    return math.prod(gain**weight for gain, weight in counted)
