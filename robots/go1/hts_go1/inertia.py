"""Rigid bodies joined into one: mass, centre of mass and inertia by the parallel-axis theorem."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Rigid:
    """A rigid body in some frame: mass kg, com (3,) m, inertia (3, 3) kg m^2 about its own com."""

    mass: float
    com: np.ndarray
    inertia: np.ndarray

    @classmethod
    def from_values(cls, mass: float, com: Sequence[float], six: Sequence[float]) -> Rigid:
        """six: ixx, ixy, ixz, iyy, iyz, izz."""
        ixx, ixy, ixz, iyy, iyz, izz = six
        return cls(mass, np.array(com, float), np.array([[ixx, ixy, ixz], [ixy, iyy, iyz], [ixz, iyz, izz]]))

    def mirrored(self, signs: Sequence[float]) -> Rigid:
        """Mirrored by a diagonal sign matrix, e.g. (1, -1, 1) for left to right."""
        flip = np.diag(np.asarray(signs, float))
        return Rigid(self.mass, flip @ self.com, flip @ self.inertia @ flip)

    def shifted(self, offset: Sequence[float]) -> Rigid:
        """The same body with its com moved by `offset` (3,) m."""
        return Rigid(self.mass, self.com + np.asarray(offset, float), self.inertia)


def joined(bodies: Sequence[Rigid]) -> Rigid:
    """One body that moves like several fixed to each other.

    I = sum_i [I_i + m_i (|d_i|^2 E - d_i d_i^T)], d_i from the common centre of mass.
    """
    mass = sum(body.mass for body in bodies)
    com = sum((body.mass * body.com for body in bodies), np.zeros(3)) / mass
    inertia = np.zeros((3, 3))
    for body in bodies:
        d = body.com - com
        inertia += body.inertia + body.mass * (d @ d * np.eye(3) - np.outer(d, d))
    return Rigid(mass, com, inertia)
