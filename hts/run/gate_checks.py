"""What the gate holds a candidate to, and which of it a robot's env can tell."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

from hts.config import RunConfig
from hts.config_gate import GateConfig
from hts.contracts import Robot, World
from hts.errors import ConfigError

NEEDS = {
    "torque": ("joint_torque", "N*m"),
    "joint_range": ("joint_position", "rad"),
    "tilt": ("projected_gravity", "1"),
    "action_rate": ("joint_target", "rad"),
}
"""Check -> the sim channel that it reads, and the unit that it expects."""

CHECKS = ("falls", *NEEDS)

UNITS = {"torque": "1", "joint_range": "rad", "tilt": "deg", "action_rate": "1", "falls": "1"}
"""Of a check's value and limit in `gate.json`."""


@dataclass(frozen=True)
class Worst:
    """The worst of one check over all env instances of a policy.

    value: torque: largest share of an instance's time in which one joint is at `torque_level` of its limit;
    joint_range: smallest distance inside the limits, rad; tilt: largest angle, degrees; action_rate: root mean square
    of a joint target's rate, as a share of the velocity limit; falls: env instances that fell. joint, set_point,
    instance, second: where and when it was (from the start of the trial; torque and action rate, shares, have none).
    peak: of torque, the largest of all as a share of the limit.
    """

    check: str
    value: float
    limit: float
    joint: str | None
    set_point: float
    instance: int
    second: float | None = None
    peak: float | None = None
    dynamics: dict[str, float] = field(default_factory=dict)

    @property
    def passed(self) -> bool:
        if self.check == "joint_range":
            return self.value >= self.limit
        return self.value <= self.limit

    def entry(self) -> dict[str, Any]:
        """As in `gate.json`."""
        rest = {key: value for key, value in vars(self).items() if key != "check" and value not in (None, {})}
        return {**rest, "unit": UNITS[self.check], "passed": self.passed}


def told_by(robot: Robot) -> tuple[str, ...]:
    """The checks that this robot's env can be held to: for the others a channel or a limit is missing."""
    spec, channels = robot.spec, robot.channels()

    def measured(check: str) -> bool:
        name, unit = NEEDS[check]
        found = channels.get(name)
        return found is not None and found.unit == unit and found.shape == ((3,) if check == "tilt" else (joints,))

    joints = spec.num_joints
    told = {
        "torque": measured("torque") and all(0 < limit < math.inf for limit in spec.torque_limit),
        "joint_range": measured("joint_range") and all(low < high for low, high in spec.position_limit),
        "tilt": measured("tilt"),
        "action_rate": measured("action_rate") and all(0 < limit < math.inf for limit in spec.velocity_limit),
        "falls": True,
    }
    return tuple(check for check in CHECKS if told[check])


def untold_by(robot: Robot) -> tuple[str, ...]:
    """The other checks."""
    told = told_by(robot)
    return tuple(check for check in CHECKS if check not in told)


def check_told(config: RunConfig, robot: Robot, world: World) -> None:
    """Raise ConfigError where a machine would get policies that nobody has held to a check, and no person vouches."""
    if world.simulated or not config.gate.enabled:
        return
    missing = [check for check in untold_by(robot) if check not in config.gate.accept_untold]
    if not missing:
        return
    why = ", ".join(f"{check} (channel '{NEEDS[check][0]}' in {NEEDS[check][1]})" for check in missing)
    raise ConfigError(
        f"gate: the env of robot '{robot.spec.name}' cannot tell {why}, and world '{config.world.name}' may be a "
        "machine. Let the robot give the channel and its limits; or vouch for it yourself, having looked: "
        f"--set gate.accept_untold=[{','.join([*config.gate.accept_untold, *missing])}]"
    )


def limits(gate: GateConfig) -> dict[str, float]:
    """Check -> what its value is held against."""
    return {
        "torque": gate.torque_share,
        "joint_range": gate.joint_margin,
        "tilt": gate.tilt,
        "action_rate": gate.action_rate,
        "falls": 0.0,
    }


def sentence(name: str, worst: Worst, gate: GateConfig, robot: Robot) -> str:
    """One line about a refused policy: what, how much, where."""
    spec, task = robot.spec, robot.task()
    index = spec.joint_names.index(worst.joint) if worst.joint is not None else 0
    what = {
        "torque": lambda: (
            f"{worst.joint} is at {gate.torque_level:.0%} of its {spec.torque_limit[index]:g} N·m or above for "
            f"{worst.value:.1%} of the time (allowed: {worst.limit:.1%})"
        ),
        "joint_range": lambda: (
            f"{worst.joint} comes within {worst.value:.3f} rad of its limits {spec.position_limit[index][0]:g} to "
            f"{spec.position_limit[index][1]:g} rad (allowed: {worst.limit:g})"
        ),
        "action_rate": lambda: (
            f"the target of {worst.joint} moves at {worst.value * spec.velocity_limit[index]:.1f} rad/s, root mean "
            f"square (allowed: {worst.limit:g} of {spec.velocity_limit[index]:g} rad/s)"
        ),
        "tilt": lambda: f"the trunk tilts by {worst.value:.0f} degrees (allowed: {worst.limit:g})",
        "falls": lambda: f"{worst.value:.0f} env instance{'' if worst.value == 1 else 's'} fell (allowed: none)",
    }[worst.check]()
    when = f", {worst.second:.1f} s after the start" if worst.second is not None else ""
    where = (f" at {worst.set_point:g} {task.unit}" if task.at(worst.set_point) else "") + when
    dynamics = f" with {', '.join(_dynamics(worst.dynamics))}" if worst.dynamics else ""
    return f"{name} is refused by the gate: {what}{where}{dynamics}"


def _dynamics(values: dict[str, float]) -> list[str]:
    words = {
        "friction": "friction {:.2f}",
        "payload": "payload {:+.1f} kg",
        "gains": "gains x {:.2f}",
        "latency": "latency {:.0f} ms",
        "lost_packets": "{:.1%} of packets lost",
    }
    return [words[key].format(value * 1000 if key == "latency" else value) for key, value in values.items()]
