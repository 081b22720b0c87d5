"""What a joint is told at most: the narrower of the robot's own limits and of those in a bundle's manifest."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from hts_go1_runtime import machine
from hts_go1_runtime.errors import RuntimeFault
from hts_go1_runtime.link import State


@dataclass(frozen=True, eq=False)
class Reach:
    """low, high: of joint targets, rad; torque: N*m, that a target may ask for; velocity: of a joint, rad/s, beyond a
    share of which the robot is stopped (`Limits`); all of shape (12,)."""

    low: np.ndarray
    high: np.ndarray
    torque: np.ndarray
    velocity: np.ndarray

    @property
    def weaker(self) -> bool:
        """Whether less torque is allowed than the motors limit by themselves."""
        return bool((self.torque < machine.TORQUE_LIMIT).any())

    def inside(self, targets: np.ndarray) -> np.ndarray:
        """Targets (12,) within the range; one that is no number stays so."""
        return np.minimum(np.maximum(targets, self.low), self.high)

    def blend_seconds(self, begin: np.ndarray, end: np.ndarray, seconds: float) -> float:
        """How long to take from pose to pose (12,): `seconds`, or longer where a joint allows less speed. Half a cosine
        is fastest in its middle: pi/2 times its mean."""
        return max(seconds, float((np.pi / 2 * np.abs(end - begin) / self.velocity).max()))

    def weakened(self, targets: np.ndarray, kp: np.ndarray, kd: np.ndarray, state: State, share: float) -> np.ndarray:
        """Targets (12,) moved so near that no more than a share of the torque is asked for in this state."""
        braking, stiffness, torque = kd * state.dq, np.maximum(kp, 1e-6), share * self.torque
        low, high = state.q + (braking - torque) / stiffness, state.q + (braking + torque) / stiffness
        return np.minimum(np.maximum(targets, low), high)


def reach_of(robot: Mapping[str, Any], where: str) -> Reach:
    """Of a manifest's robot. Raises RuntimeFault for limits wider than the robot's own, and for such as leave a joint
    no range or no torque."""
    ranges = np.asarray(robot["position_limit"], float)
    velocity, torque = (np.asarray(robot[key], float) for key in ("velocity_limit", "torque_limit"))
    if ranges.shape != (12, 2) or velocity.shape != (12,) or torque.shape != (12,):
        raise RuntimeFault(f"{where}: limits of other than 12 joints. Make the bundle for this robot.")
    low, high = ranges.T
    for what, fits in (
        ("position_limit", (low >= machine.POSITION_LOW - 1e-9) & (high <= machine.POSITION_HIGH + 1e-9)),
        ("velocity_limit", velocity <= machine.VELOCITY_LIMIT + 1e-9),
        ("torque_limit", torque <= machine.TORQUE_LIMIT + 1e-9),
    ):
        if (joint := machine.first_of(~fits)) is not None:  # so put, a limit that is no number is refused too
            raise RuntimeFault(
                f"{where}: {what} of {machine.JOINTS[joint]} is wider than the robot's own, or no number. Make the "
                "bundle for this robot."
            )
    found = Reach(
        np.maximum(low, machine.TARGET_LOW),
        np.minimum(high, machine.TARGET_HIGH),
        np.minimum(torque, machine.TORQUE_LIMIT),
        np.minimum(velocity, machine.VELOCITY_LIMIT),
    )
    if (at := machine.first_of((found.low >= found.high) | (found.torque <= 0) | (velocity <= 0))) is not None:
        raise RuntimeFault(
            f"{where}: {machine.JOINTS[at]} may go from {found.low[at]:g} to {found.high[at]:g} rad at "
            f"{velocity[at]:g} rad/s with {found.torque[at]:g} N·m: nothing can be done with that. Make the "
            "bundle for this robot."
        )
    return found
