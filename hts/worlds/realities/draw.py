"""One draw: values for everything in `ranges`, from a seed and an index.

Each parameter has random numbers of its own, from seed, index and its key. So what a plugin adds later changes none
of the values of the others, and one draw does not depend on how many came before.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from hts.worlds.realities.ranges import Drawn, switches

PROBABILITY = 0.5  # of each structural switch
DIGITS = 6  # significant, of a drawn number: what a person can read


@dataclass(frozen=True)
class Draw:
    """Values by dotted key, of what was drawn; and the switches that are on."""

    values: Mapping[str, Any]
    switches: tuple[str, ...]

    def nested(self) -> dict[str, Any]:
        """{"dynamics": {"structure": {...}, ...}, ...}"""
        content: dict[str, Any] = {}
        for key, value in self.values.items():
            *path, name = key.split(".")
            below = content
            for part in path:
                below = below.setdefault(part, {})
            below[name] = value
        return content


def draw(parameters: Sequence[Drawn], seed: str, index: int) -> Draw:
    """The draw of that index."""
    on = [name for name in switches(list(parameters)) if rng_of(seed, index, f"switch {name}").random() < PROBABILITY]
    values: dict[str, Any] = {}
    for one in parameters:
        if one.switch is None or one.switch in on:
            values[one.key] = _value(one, seed, index)
    return Draw(values, tuple(on))


def _value(one: Drawn, seed: str, index: int) -> Any:
    rng = rng_of(seed, index, one.key)
    if one.boolean:
        return True
    if one.whole:
        return int(rng.integers(int(one.low), int(one.high), endpoint=True))
    if one.counts is None:
        return number(one, rng.random())
    count = int(rng_of(seed, index, f"count {one.group}").integers(*one.counts, endpoint=True))
    several = [number(one, share) for share in rng.random(count)]
    return sorted(several) if one.ascending else several


def number(one: Drawn, share: float) -> float:
    """The value below which this share of the range lies, rounded."""
    return min(max(float(f"{one.at(share):.{DIGITS}g}"), one.low), one.high)


def rng_of(seed: str, *what: object) -> np.random.Generator:
    """Random numbers for one purpose, from the seed of all draws; another one's share none with them."""
    words = hashlib.sha256("\n".join(map(str, (seed, *what))).encode()).digest()
    return np.random.default_rng(np.frombuffer(words, dtype="<u4").tolist())
