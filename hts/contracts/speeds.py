"""How fast a machine may be told to go: more is another unit."""

from __future__ import annotations

from hts.contracts.robot import RobotSpec

# m/s and rad/s: legged robots run at some m/s. Written in mm/s these are thousands, in cm/s hundreds.
FASTEST_ON_LEGS, FASTEST = 20.0, 100.0


def fastest(spec: RobotSpec) -> float:
    """What no velocity of such a machine is beyond, m/s, and no yaw rate, rad/s."""
    return FASTEST_ON_LEGS if spec.foot_sites else FASTEST
