"""Whether the numbers that a source states can be: of this robot, and in the units that they are asked for in."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

from hts.contracts import RobotSpec
from hts.contracts.spec_faults import ROUNDED
from hts.errors import PolicyError
from hts.policies.contract import Contract, known_joints, per_joint

STIFFEST = 30.0
"""1/rad: kp over torque limit. Such a servo is at its limit after 1.9 degrees, a switch and no spring: a
bound of ours, far from what a leg needs."""
MOST_DAMPED = 5.0
"""s/rad: kd over torque limit: at its limit at 0.2 rad/s; likewise."""


def check_values(path: Path, contract: Contract, robot: RobotSpec) -> None:
    """Raises PolicyError, in one line, for numbers that cannot be this robot's: a default pose outside its range,
    gains or scales that are no such thing. What equals the robot's own number is never refused."""
    names = known_joints(path, contract, robot)
    faults = []
    for key, fault in CHECKS.items():
        values = getattr(contract, key)
        if values is None:
            continue
        stated = dict(zip(names, per_joint(path, key, values, names), strict=True))
        own = dict(zip(robot.joint_names, getattr(robot, key), strict=True))
        other = [name for name in robot.joint_names if not math.isclose(stated[name], own[name], abs_tol=1e-9)]
        told = [(name, words) for name in other if (words := fault(robot, name, stated[name]))]
        if not told:
            continue
        where = f" (stated by {contract.said_by[key]})" if key in contract.said_by else ""
        more = f", and {len(told) - 1} more" if len(told) > 1 else ""
        faults.append(f"{key}{where} of joint '{told[0][0]}' {told[0][1]}{more}")
        if key == "default_pose" and not any(fault(robot, name, math.radians(stated[name])) for name in stated):
            faults[-1] += "; in degrees they would fit: state them in rad"
    if faults:
        raise PolicyError(
            f"{path}: {'. '.join(faults)}. Correct it in the layout (--layout), or the robot's spec if that is wrong."
        )


def _pose(robot: RobotSpec, name: str, value: float) -> str:
    low, high = robot.position_limit[robot.joint_names.index(name)]
    if low - ROUNDED <= value <= high + ROUNDED:
        return ""
    return f"is {value:.4g} rad, outside its range {low:.4g} to {high:.4g} rad of robot '{robot.name}'"


def _scale(robot: RobotSpec, name: str, value: float) -> str:
    low, high = robot.position_limit[robot.joint_names.index(name)]
    if value <= 0:
        return f"is {value:.4g} rad per action unit, expected a number above 0"
    if value <= high - low:
        return ""
    return (
        f"is {value:.4g} rad per action unit, more than its whole range of {high - low:.4g} rad in robot "
        f"'{robot.name}'; a leg's is 0.25 or so"
    )


def _kp(robot: RobotSpec, name: str, value: float) -> str:
    if value <= 0:
        return f"is {value:.4g} N*m/rad, expected a number above 0: without it no target is followed"
    return _beyond(robot, name, value, STIFFEST, "N*m/rad", "1/rad")


def _kd(robot: RobotSpec, name: str, value: float) -> str:
    return _beyond(robot, name, value, MOST_DAMPED, "N*m*s/rad", "s/rad")


def _beyond(robot: RobotSpec, name: str, value: float, most: float, unit: str, per_torque: str) -> str:
    limit = robot.torque_limit[robot.joint_names.index(name)]
    if value <= most * limit:
        return ""
    return (
        f"is {value:.4g} {unit}, expected up to {most * limit:.4g}, {most:g} {per_torque} times its torque limit of "
        f"{limit:.4g} N*m in robot '{robot.name}'"
    )


CHECKS: dict[str, Callable[[RobotSpec, str, float], str]] = {
    "default_pose": _pose,
    "action_scale": _scale,
    "kp": _kp,
    "kd": _kd,
}
