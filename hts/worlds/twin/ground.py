"""The floor of a reality: bumps as a height field, slopes as tilted gravity; and the wind over it.

Bumps repeat after PERIOD, and a robot that walks past the middle of one period is set back by one, so a small height
field is an endless floor. A slope is gravity that does not point straight down at a level floor, the same thing.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from hts.worlds.twin.structure import BodyStructure, SessionParameters

PERIOD = 4.0  # m
MARGIN = 0.6  # m: beyond half a period on each side, for the legs of a robot that stands there
CELL = 0.05  # m
HALF = PERIOD / 2 + MARGIN  # m
CELLS = round(2 * HALF / CELL) + 1  # of the height field, along each of its sides
LONGEST_BUMP = 2.0  # m
GUST_SECONDS = 2.0


@dataclass(frozen=True)
class Conditions:
    """What differs between the sessions of W robots. All (W,): friction: factor on the floor's; slope_direction,
    wind_direction: rad, seen from above; heading_gain: factor; heading_offset: rad."""

    friction: np.ndarray
    slope_direction: np.ndarray
    wind_direction: np.ndarray
    heading_gain: np.ndarray
    heading_offset: np.ndarray

    @staticmethod
    def drawn(sessions: SessionParameters, num_worlds: int, rng: np.random.Generator) -> Conditions:
        """Of sessions as their spreads say. Wind comes from one side of the track, within 30 degrees."""
        spread = rng.uniform(-1, 1, (3, num_worlds))
        side = np.where(rng.random(num_worlds) < 0.5, -0.5, 0.5) * np.pi
        return Conditions(
            friction=1 + sessions.floor_friction_spread * spread[0],
            slope_direction=rng.uniform(-np.pi, np.pi, num_worlds),
            wind_direction=side + rng.uniform(-np.pi / 6, np.pi / 6, num_worlds),
            heading_gain=1 + sessions.heading_gain_spread * spread[1],
            heading_offset=sessions.heading_offset * spread[2],
        )


def bumpy_floor(root: Any, roughness: float) -> Any:
    """The robot's model with a height field instead of its plane; `heights` fills it in after compilation."""
    field = root.asset.add("hfield", name="twin_floor", nrow=CELLS, ncol=CELLS, size=[HALF, HALF, 2 * roughness, 0.1])
    for geom in root.worldbody.geom:
        if geom.type == "plane":
            geom.type, geom.hfield = "hfield", field
            geom.pos = [0, 0, -roughness]
            del geom.size
    return root


def heights(structure: BodyStructure, serial: int) -> np.ndarray:
    """Elevation of the height field, 0 to 1 of 2 `floor_roughness`, with mean near ½, (rows, columns).

    A sum of waves that repeat after PERIOD, with wavelengths between `bump_length` and LONGEST_BUMP, scaled so that the
    highest or deepest bump is `floor_roughness`.
    """
    axis = np.linspace(-HALF, HALF, CELLS)
    rng = np.random.default_rng([serial, 4])
    most = max(1, int(PERIOD / max(structure.bump_length, 2 * CELL)))
    least = PERIOD / LONGEST_BUMP
    waves = [
        (i, j)
        for i in range(-most, most + 1)
        for j in range(most + 1)
        if least <= np.hypot(i, j) <= max(most, least) and (j > 0 or i > 0)
    ]
    chosen = rng.choice(len(waves), min(len(waves), 24), replace=False)
    surface = np.zeros((len(axis), len(axis)))
    for number, phase in zip(chosen, rng.uniform(0, 2 * np.pi, len(chosen)), strict=True):
        i, j = waves[int(number)]
        across = 2 * np.pi / PERIOD * (i * axis[None, :] + j * axis[:, None]) + phase
        surface += np.cos(across) / np.hypot(i, j)  # longer bumps are higher
    return np.asarray(0.5 + 0.5 * surface / np.abs(surface).max())


def gravity(structure: BodyStructure, direction: float, strength: float) -> np.ndarray:
    """Gravity, m/s^2 (3,), in the frame of a floor that falls towards `direction` by `floor_slope`."""
    slope = np.radians(structure.floor_slope)
    down = (np.sin(slope) * np.cos(direction), np.sin(slope) * np.sin(direction), -np.cos(slope))
    return strength * np.array(down)


class Wind:
    """A force on the trunks of W robots: a mean, and gusts around it (Ornstein-Uhlenbeck, 2 s)."""

    def __init__(self, structure: BodyStructure, directions: np.ndarray, rng: np.random.Generator) -> None:
        self._mean, self._gust, self._rng = structure.wind_force, structure.wind_gust, rng
        self._direction = np.stack([np.cos(directions), np.sin(directions)], axis=1)  # (W, 2)
        self._state = rng.standard_normal(len(directions))

    def blow(self, seconds: float) -> np.ndarray:
        """Force along world x and y, N (W, 2), for the next `seconds`."""
        keep = np.exp(-seconds / GUST_SECONDS)
        self._state = keep * self._state + np.sqrt(1 - keep**2) * self._rng.standard_normal(len(self._state))
        force = self._mean * np.maximum(1 + self._gust * self._state, 0)
        return np.asarray(force[:, None] * self._direction)
