"""What no robot's numbers may be: another count than joints, no numbers, steps that do not make a control step."""

from __future__ import annotations

import math
from typing import Any

from hts.contracts.robot import RobotSpec

MOST_ANGLE, HIGHEST, FASTEST = 10.0, 5.0, 100.0
"""rad, more than a turn and a half, m and rad/s, five times a fast leg: of no leg's joint, no walking robot's trunk."""
ENDLESS = 60.0
"""rad: a joint whose range is as wide as some ten turns is a wheel or a winch."""
ROUNDED = 0.01
"""rad: so far may a default pose be outside its range, which is rounded somewhere."""

NOT_BELOW_ZERO = ("kp", "kd")  # 0: actions are torques, or nobody knows
ABOVE_ZERO = (
    "action_scale",  # joint targets of a log are divided by it
    "torque_limit",  # without one the gate would not look at torques, and a log's would all be beyond it
    "velocity_limit",
    "motors.torque_constant",
    "motors.gear_ratio",
    "motors.phase_resistance_ohm",
)


def fault_of_spec(spec: RobotSpec) -> str:
    """The first thing that nobody can compute with, in words; empty for none. Policies are made and robots commanded by
    these numbers, so a tuple that is one too short must not go unseen until then."""
    per_joint: dict[str, tuple[Any, str]] = {
        "default_pose": (spec.default_pose, "a number, rad"),
        "kp": (spec.kp, "a number, N·m/rad"),
        "kd": (spec.kd, "a number, N·m·s/rad"),
        "action_scale": (spec.action_scale, "a number, rad per action unit"),
        "torque_limit": (spec.torque_limit, "a number, N·m"),
        "velocity_limit": (spec.velocity_limit, "a number, rad/s"),
        "position_limit": (spec.position_limit, "(low, high), rad"),
    }
    if spec.motors is not None:
        per_joint |= {
            "motors.torque_constant": (spec.motors.torque_constant, "a number, N·m/A"),
            "motors.gear_ratio": (spec.motors.gear_ratio, "a number"),
            "motors.phase_resistance_ohm": (spec.motors.phase_resistance_ohm, "a number, ohm"),
        }
    for name, (values, wanted) in per_joint.items():
        if fault := _per_joint(f"spec.{name}", values, wanted, spec.joint_names):
            return fault
    for joint, (low, high) in zip(spec.joint_names, spec.position_limit, strict=True):
        if low > high:
            return f"spec.position_limit of '{joint}' is {low:g} to {high:g}, expected the lower end first, rad"
    for name in filter(per_joint.__contains__, ABOVE_ZERO):
        for joint, value in zip(spec.joint_names, per_joint[name][0], strict=True):
            if not value > 0:
                return f"spec.{name} of '{joint}' is {value:g}, expected a number above 0"
    for name in NOT_BELOW_ZERO:
        for joint, value in zip(spec.joint_names, per_joint[name][0], strict=True):
            if value < 0:
                return f"spec.{name} of '{joint}' is {value:g}, expected a number of at least 0"
    return _in_degrees(spec) or _of_no_leg(spec) or fault_of_height(spec) or fault_of_times(spec)


def _in_degrees(spec: RobotSpec) -> str:
    """In words, for a pose of legs that is not in rad; else empty. A winch may be many turns away from its zero."""
    for joint, angle in zip(spec.joint_names, spec.default_pose if spec.foot_sites else (), strict=False):
        if abs(angle) > MOST_ANGLE:
            return (
                f"spec.default_pose of '{joint}' is {angle:g}, expected at most {MOST_ANGLE:g} rad (write rad, not "
                "degrees)"
            )
    return ""


def _of_no_leg(spec: RobotSpec) -> str:
    """In words, for a leg's joint that rests outside its range, that one action unit moves beyond it, or that is faster
    than any: a number in degrees, or per minute. Else empty."""
    columns = (spec.joint_names, spec.default_pose, spec.position_limit, spec.action_scale, spec.velocity_limit)
    for joint, pose, (low, high), scale, fastest in zip(*columns, strict=True) if spec.foot_sites else ():
        if not low - ROUNDED <= pose <= high + ROUNDED:
            in_rad = math.radians(low) - ROUNDED <= pose <= math.radians(high) + ROUNDED
            why = "position_limit is probably in degrees: write rad" if in_rad else "correct one of them, both in rad"
            where = f"outside its position_limit {low:g} to {high:g}"
            return f"spec.default_pose of '{joint}' is {pose:g} rad, {where} ({why})"
        if high - low > ENDLESS:
            continue
        if scale > high - low:
            return (
                f"spec.action_scale of '{joint}' is {scale:g} rad per action unit, more than its whole range of "
                f"{high - low:.4g} rad (write rad, not degrees; a leg's is 0.25 or so)"
            )
        if fastest > FASTEST:
            return (
                f"spec.velocity_limit of '{joint}' is {fastest:g}, expected at most {FASTEST:g} rad/s (write rad/s, "
                "not degrees per second or turns per minute)"
            )
    return ""


def fault_of_height(spec: RobotSpec) -> str:
    """In words, for a standing height that is not in m; else empty."""
    if spec.foot_sites and not abs(spec.base_height) <= HIGHEST:
        return f"spec.base_height is {spec.base_height:g}, expected at most {HIGHEST:g} m (write m, not mm)"
    return ""


def fault_of_times(spec: RobotSpec) -> str:
    """In words, if physics steps do not make one control step; else empty."""
    period = spec.physics_dt * spec.substeps
    if not abs(period * spec.control_rate_hz - 1) < 1e-6:
        return (
            f"{spec.substeps} · {spec.physics_dt} s at {spec.control_rate_hz} Hz; expected "
            "spec.substeps · spec.physics_dt = 1 / spec.control_rate_hz"
        )
    return ""


def fault_of_step(dt: float, spec: RobotSpec) -> str:
    """In words, if the control step of the robot's env, s, is not the robot's; else empty. Measurement models and
    policies are stepped once a control step, so at another rate they would say something else."""
    if abs(dt * spec.control_rate_hz - 1) < 1e-3:
        return ""
    return (
        f"its env has dt = {dt:g} s, expected {1 / spec.control_rate_hz:g} s, a control step at the "
        f"{spec.control_rate_hz:g} Hz of spec.control_rate_hz: recordings and measurement models are at that rate"
    )


def _per_joint(name: str, values: Any, wanted: str, joints: tuple[str, ...]) -> str:
    try:
        entries = list(values)
    except TypeError:
        return f"{name} is {values!r}, expected {len(joints)} entries, one a joint in the order of joint_names"
    if len(entries) != len(joints):
        return f"{name} has {len(entries)} entries for {len(joints)} joints"
    pairs = wanted.startswith("(")
    for joint, entry in zip(joints, entries, strict=True):
        if not (_pair(entry) if pairs else _number(entry)):
            return f"{name} of '{joint}' is {entry!r}, expected {wanted}"
    return ""


def _number(value: Any) -> bool:
    try:
        return not isinstance(value, str) and math.isfinite(value)
    except TypeError:
        return False


def _pair(value: Any) -> bool:
    """Two numbers, either of which may be endless; not two NaN."""
    try:
        low, high = value
        return not isinstance(value, str) and not math.isnan(low) and not math.isnan(high)
    except (TypeError, ValueError):
        return False
