"""What the runtime knows of the robot by itself, to hold a bundle against. SI units, joints in the SDK's order.

From `hts_go1.constants`, which imports nothing; sources there. `SDK_POSITION_LIMIT`: go1_const.h of Unitree's
unitree_legged_sdk (v3.8.0), narrower than the URDF's at thigh and calf. Gains: largest that a policy may ask for; the
SDK's position example uses 5 and 1, common policies 20 to 35 and 0.5; twice that is refused as a mistake (estimate).
"""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np

from hts_go1 import constants as c
from hts_go1_runtime.errors import RuntimeFault

JOINTS = c.JOINT_NAMES
SDK_POSITION_LIMIT = {"hip": (-1.047, 1.047), "thigh": (-0.663, 2.966), "calf": (-2.721, -0.837)}
LARGEST_KP, LARGEST_KD = 80.0, 5.0  # N m/rad, N m s/rad
LARGEST_SCALE = 1.0  # rad per action unit
DAMPING_KD = 4.0  # N m s/rad of the damping command (estimate): a collapsing robot takes about a second


def per_joint(values: dict[str, float]) -> np.ndarray:
    """One value per joint (12,) from one per part."""
    return np.array([values[part] for _ in c.LEGS for part in c.PARTS])


def first_of(joints: np.ndarray) -> int | None:
    """The first joint of a mask (12,); None where there is none."""
    found = np.flatnonzero(joints)
    return int(found[0]) if found.size else None


TORQUE_LIMIT = per_joint(c.TORQUE_LIMIT)
VELOCITY_LIMIT = per_joint(c.VELOCITY_LIMIT)
POSITION_LOW = per_joint({part: c.POSITION_LIMIT[part][0] for part in c.PARTS})
POSITION_HIGH = per_joint({part: c.POSITION_LIMIT[part][1] for part in c.PARTS})
TARGET_LOW = np.maximum(POSITION_LOW, per_joint({part: SDK_POSITION_LIMIT[part][0] for part in c.PARTS}))
TARGET_HIGH = np.minimum(POSITION_HIGH, per_joint({part: SDK_POSITION_LIMIT[part][1] for part in c.PARTS}))
STAND = per_joint(c.DEFAULT_POSE)
SIT = per_joint({"hip": 0.0, "thigh": 1.3, "calf": -2.5})  # folded, trunk near the floor, inside all limits


@dataclass(frozen=True)
class Limits:
    """Beyond which the robot is stopped. Raises RuntimeFault for one that is not finite: it would stop nobody.

    tilt: of the trunk, rad; position_margin: rad beyond the joint's range; velocity_share: of the joint's limit;
    current: drawn from the pack, A; voltage: lowest of the pack, V (cut-off is 18.0: GO1 User Manual V1.4);
    temperature: of a motor, degC (it trips at 90 and lags the winding); silence: since the robot's last state, s;
    stale: how much later than usual a state may arrive, s; late: of a control step behind its deadline, s;
    least_torque_share: of the torque that is asked of the joints, see `following`; frozen: for how long a sensor may
    repeat itself, s, 0: for ever, see `frozen`; velocity: of each joint, rad/s, `velocity_share` of which is allowed.
    """

    tilt: float = 0.8
    position_margin: float = 0.1
    velocity_share: float = 1.2
    current: float = 30.0
    voltage: float = 18.6
    temperature: float = 80.0
    silence: float = 0.024
    stale: float = 0.024
    late: float = 0.030
    least_torque_share: float = 0.35
    frozen: float = 0.1
    velocity: tuple[float, ...] = tuple(float(one) for one in VELOCITY_LIMIT)

    def __post_init__(self) -> None:
        for name, value in asdict(self).items():
            if not np.isfinite(value).all():
                raise RuntimeFault(
                    f"limit '{name}' is {value}, expected a finite number: no robot would be stopped by it."
                )
