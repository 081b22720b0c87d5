"""Approximate Bayesian computation by sequential Monte Carlo: points that agree with data within a tolerance.

    π_ε(u) ∝ prior(u) 1[d(u) ≤ ε],   ε falling to what was asked for

d is a distance between what a point's simulation shows and the data, in tolerances. A population of N begins with the
prior. In each generation ε becomes the median distance of the population (`KEPT`), points beyond it are replaced by
copies of others, and every point makes some Metropolis steps that leave π_ε as it is. That is the adaptive sampler of
Del Moral, Doucet and Jasra 2012 (Statistics and Computing 22, 1009-1020), one simulation a point. Toni et al. 2009 and
Beaumont et al. 2009 jump from the population with importance weights instead, which among a hundred parameters fall on
one point; here proposals are reversible with respect to the prior (space.py), so a step is accepted if d ≤ ε, and
weights stay equal: a point's weight is how many copies of it there are.

Because acceptance is yes or no, a proposal is given up as soon as one figure is beyond ε: same result, less work.
Where a part of the agreement costs no simulation (`free`), a step first makes `FREE_STEPS` small ones that hold that
part within its tolerance and tries where it ends (Liu 2001, section 9.4.3: reversible steps put together are
reversible with respect to what each of them leaves as it is).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from hts.errors import RunError
from hts.worlds.realities.space import Space

KEPT = 0.5  # of the population, which distance the next ε is
FREE_STEPS = 4
TRIES = 20_000  # of the prior, for a first point
FIRST_STEP, ACCEPTED = 0.5, 0.25  # size of a step, and the share that should be accepted
LEAST_STEP, MOST_STEP = 0.05, 1.0


@dataclass(frozen=True)
class Found:
    """What a simulation showed. distance: in tolerances, infinite where it ended early; shown: figure -> value."""

    distance: float
    shown: Mapping[str, float] = field(default_factory=dict)
    why: str = ""


Free = Callable[[np.ndarray], float]
"""Distance of a point as far as it costs nothing."""
Simulate = Callable[[np.ndarray, float], Found]
"""Distance of a point; one beyond the bound may be given up."""


@dataclass(frozen=True)
class Particle:
    """A point of the population, and what it took to come here: simulations, and steps that were accepted."""

    point: np.ndarray
    found: Found
    simulated: int
    accepted: int

    def plain(self) -> dict[str, Any]:
        """As JSON."""
        found = self.found
        return {
            "distance": found.distance if math.isfinite(found.distance) else None,
            "shown": {name: round(value, 4) for name, value in found.shown.items()},
            **({"why": found.why} if found.why else {}),
            "simulated": self.simulated,
            "accepted": self.accepted,
            "point": self.point.tolist(),
        }

    @staticmethod
    def of(plain: Mapping[str, Any]) -> Particle:
        """What `plain` gave."""
        distance = math.inf if plain["distance"] is None else plain["distance"]
        found = Found(distance, plain["shown"], plain.get("why", ""))
        return Particle(np.array(plain["point"]), found, plain["simulated"], plain["accepted"])


def first(space: Space, free: Free, within: float, simulate: Simulate, rng: np.random.Generator) -> Particle:
    """A point of the prior that agrees as far as that is free, simulated to its end. Raises RunError if none does."""
    for _ in range(TRIES):
        point = space.prior(rng)
        if free(point) <= within:
            return Particle(point, simulate(point, math.inf), 1, 0)
    raise RunError(
        f"None of {TRIES} draws has the idle levels of these recordings: they lie outside of what realities are drawn "
        "over (`hts realities ranges`). Look at units and signs first; a wider --discrepancy lets more agree."
    )


def walk(
    space: Space,
    begin: Particle,
    bound: float,
    within: float,
    step: float,
    steps: int,
    free: Free,
    simulate: Simulate,
    rng: np.random.Generator,
) -> Particle:
    """Metropolis steps from a point with distance ≤ bound; all points on the way have one."""
    point, found, simulated, accepted = begin.point, begin.found, 0, 0
    for _ in range(steps):
        tried = point
        for _ in range(FREE_STEPS):
            next_ = space.moved(tried, step / math.sqrt(FREE_STEPS), rng)
            if free(next_) <= within:
                tried = next_
        if tried is point:
            continue
        there = simulate(tried, bound)
        simulated += 1
        if there.distance <= bound:
            point, found, accepted = tried, there, accepted + 1
    return Particle(point, found, simulated, accepted)


def next_bound(distances: Sequence[float], within: float) -> float:
    """ε of the next generation. Raises RunError where nothing is left to go on from."""
    finite = sorted(one for one in distances if math.isfinite(one))
    if len(finite) < 2:
        raise RunError(
            f"{len(finite)} of {len(distances)} draws walked at all with this policy, too few to go on from. "
            "A larger --population holds more."
        )
    middle = min(max(1, math.ceil(KEPT * len(distances)) - 1), len(finite) - 1)
    return max(within, finite[middle])


def ancestors(distances: Sequence[float], bound: float, rng: np.random.Generator) -> list[int]:
    """Who each place of the next generation begins from: who agrees stays, the others' places go to those in turn."""
    alive = [index for index, distance in enumerate(distances) if distance <= bound]
    turn = itertools.cycle(rng.permutation(alive).tolist())
    return [index if distance <= bound else next(turn) for index, distance in enumerate(distances)]


def next_step(step: float, population: Sequence[Particle]) -> float:
    """Larger steps where more than `ACCEPTED` of the simulated ones were accepted, smaller where fewer."""
    simulated, accepted = effort(population)
    if not simulated:
        return step
    factor = min(max((accepted / simulated) / ACCEPTED, 0.5), 2.0) ** 0.7
    return float(min(max(step * factor, LEAST_STEP), MOST_STEP))


def effort(population: Iterable[Particle]) -> tuple[int, int]:
    """Simulations that it took to come here, and how many of them were accepted."""
    particles = list(population)
    return sum(one.simulated for one in particles), sum(one.accepted for one in particles)


def copies(population: Sequence[Particle]) -> dict[int, float]:
    """Index of each point that differs from those before -> its weight, which sum to 1."""
    seen: dict[bytes, int] = {}
    weights: dict[int, float] = {}
    for index, one in enumerate(population):
        where = seen.setdefault(one.point.tobytes(), index)
        weights[where] = weights.get(where, 0.0) + 1 / len(population)
    return weights


def chosen(weights: Mapping[int, float], count: int, rng: np.random.Generator) -> dict[int, float]:
    """At most `count` of them for the whole, with new weights: all if they are no more, else by systematic resampling
    (one random number, then equal strides through the cumulated weights)."""
    if len(weights) <= count:
        return dict(weights)
    indices = list(weights)
    edges = np.cumsum([weights[index] for index in indices])
    places = (rng.random() + np.arange(count)) / count * edges[-1]
    found: dict[int, float] = {}
    for place in np.searchsorted(edges, places, side="right"):
        index = indices[min(int(place), len(indices) - 1)]
        found[index] = found.get(index, 0.0) + 1 / count
    return found
