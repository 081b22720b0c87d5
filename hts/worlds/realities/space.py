"""Draws as points: one number between 0 and 1 for everything that chance decides in a draw, uniform over the prior.

A point has a coordinate for each switch, for each value, also of those whose switch is off, and for how many values a
group has; so every point is a draw, and a walk from point to point may turn a structure on and off again.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.special import ndtr, ndtri

from hts.worlds.realities.draw import PROBABILITY, Draw, number
from hts.worlds.realities.ranges import Drawn, switches

EDGE = 1e-12  # coordinates keep so far from 0 and 1, where a normal variable is infinite


class Space:
    """All draws of these parameters, as the unit cube with its uniform prior.

    at: place of each coordinate, by the key of its switch or value, with its number where there are several; stepped:
    (D,), choices between whole things (a switch, a count, a serial number), to which near points mean nothing.
    """

    def __init__(self, parameters: Sequence[Drawn]) -> None:
        self.parameters = tuple(parameters)
        self.switches = tuple(switches(list(parameters)))
        groups = {one.group: one.counts[1] for one in parameters if one.counts}
        found = {f"switch {name}": True for name in self.switches} | {f"count {name}": True for name in groups}
        for one in parameters:
            if one.counts:
                found |= {f"{one.key} {index}": False for index in range(one.counts[1])}
            elif not one.boolean:
                found[one.key] = one.whole
        self.at = {key: index for index, key in enumerate(found)}
        self.stepped = np.array([*found.values()])

    @property
    def size(self) -> int:
        return len(self.at)

    def prior(self, rng: np.random.Generator) -> np.ndarray:
        """A point of the prior, (D,)."""
        return np.clip(rng.random(self.size), EDGE, 1 - EDGE)

    def moved(self, point: np.ndarray, step: float, rng: np.random.Generator) -> np.ndarray:
        """A point near this one, reversible with respect to the prior: (D,) -> (D,).

        A random part p of the coordinates moves, each by z' = √(1 − β²) z + β ξ, z = Φ⁻¹(u), ξ ~ N(0, 1), the
        preconditioned Crank-Nicolson proposal (Cotter, Roberts, Stuart and White 2013, eq. 4.4), whose acceptance does
        not fall with the number of coordinates that data say nothing of; stepped ones are drawn anew with probability
        β². p is log-uniform from one coordinate to all, and β² = min(1, step² / p): many by a little or few at all.
        """
        share = self.size ** -rng.random()
        beta = min(1.0, step / np.sqrt(share))
        chosen = rng.random(self.size) < share
        chosen[rng.integers(self.size)] = True
        noise, anew, coin = rng.standard_normal(self.size), rng.random(self.size), rng.random(self.size)
        walked = ndtr(np.sqrt(1 - beta**2) * ndtri(point) + beta * noise)
        jumped = np.where(coin < beta**2, anew, point)
        return np.clip(np.where(chosen, np.where(self.stepped, jumped, walked), point), EDGE, 1 - EDGE)

    def draw(self, point: np.ndarray) -> Draw:
        """What the point says."""
        on = tuple(name for name in self.switches if point[self.at[f"switch {name}"]] < PROBABILITY)
        values = {one.key: self._value(one, point) for one in self.parameters if one.switch is None or one.switch in on}
        return Draw(values, on)

    def _value(self, one: Drawn, point: np.ndarray) -> Any:
        if one.boolean:
            return True
        if one.counts:
            low, high = one.counts
            count = low + int(point[self.at[f"count {one.group}"]] * (high - low + 1))
            several = [number(one, float(point[self.at[f"{one.key} {index}"]])) for index in range(count)]
            return sorted(several) if one.ascending else several
        share = float(point[self.at[one.key]])
        if one.whole:
            return int(one.low) + int(share * (int(one.high) - int(one.low) + 1))
        return number(one, share)
