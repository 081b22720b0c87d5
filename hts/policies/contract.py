"""What the maker of a policy has to say of it beside its numbers: read from the source, or asked for, never guessed."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from hts.contracts import RobotSpec
from hts.errors import PolicyError

Values = float | Sequence[float] | Mapping[str, float]
"""One number for all joints, one for each in the source's order, or by name or pattern of names."""

ASKED = {
    "joint_names": "the source's joint order, by the robot's names",
    "default_pose": "joint angles where an action is zero, rad",
    "action_scale": "rad per action unit",
    "kp": "gains of the joint controllers, N*m/rad",
    "kd": "gains of the joint controllers, N*m*s/rad",
    "control_rate_hz": "how often the policy was asked, Hz",
    "delay_seconds": "from observation to the target's effect that it was trained with, s: one number or [low, high]",
}
"""Every key that has to be stated, and what it means."""
OBSERVED = "its parts in its order, with their scales"
GAINS = ("kp", "kd")
OF_JOINTS = ("default_pose", "action_scale", *GAINS)


@dataclass(frozen=True)
class Contract:
    """What a source says of its policy; None: it does not say.

    joint_names: in the source's order; default_pose rad, action_scale rad per action unit, kp N·m/rad, kd N·m·s/rad:
    one number for all joints, a sequence in the source's order, or a mapping of names or regular expressions;
    control_rate_hz Hz; delay_seconds: (least, most) that it was trained with; action_clip: actions were kept within
    ± this, None for not; said_by: key -> where it was read.
    """

    joint_names: tuple[str, ...] | None = None
    default_pose: Values | None = None
    action_scale: Values | None = None
    kp: Values | None = None
    kd: Values | None = None
    control_rate_hz: float | None = None
    delay_seconds: tuple[float, float] | None = None
    action_clip: float | None = None
    said_by: Mapping[str, str] = field(default_factory=dict)

    def missing(self) -> list[str]:
        """Keys that the source does not state."""
        return [key for key in ASKED if getattr(self, key) is None]

    def over(self, other: Contract) -> Contract:
        """This one, and where it says nothing the other."""
        keys = [*ASKED, "action_clip"]
        taken = {key: getattr(other, key) for key in keys if getattr(self, key) is None}
        said = {**other.said_by, **{key: value for key, value in self.said_by.items() if key not in taken}}
        return replace(self, **taken, said_by=said)

    def of_robot(self, robot: RobotSpec) -> Contract:
        """This one, and where it says nothing the robot's own numbers. A delay is of no robot: it stays unsaid."""
        order = self.joint_names or robot.joint_names
        own = {key: dict(zip(robot.joint_names, getattr(robot, key), strict=True)) for key in OF_JOINTS}
        named: dict[str, Any] = {"joint_names": order, "control_rate_hz": robot.control_rate_hz, **own}
        return self.over(Contract(**named, said_by=dict.fromkeys(named, "the robot")))


def known_joints(path: Path, contract: Contract, robot: RobotSpec) -> tuple[str, ...]:
    """The source's joint order. Raises PolicyError unless it names the robot's joints."""
    names = contract.joint_names or robot.joint_names
    if sorted(names) != sorted(robot.joint_names):
        odd = sorted(set(names) ^ set(robot.joint_names)) or sorted(names)
        raise PolicyError(
            f"{path}: its joints {sorted(names)} are not those of robot '{robot.name}' (in one only, or twice: {odd}). "
            "Give joint_names in the layout: the robot's names, in the policy's order."
        )
    return tuple(names)


def per_joint(path: Path, what: str, values: Values, names: Sequence[str]) -> tuple[float, ...]:
    """One number per joint, in the order of names. Raises PolicyError naming the joint that has none, or two, and for
    gains below 0."""
    found = _per_joint(path, what, values, names)
    least = min(found, default=0.0)
    if what in GAINS and least < 0:
        raise PolicyError(f"{path}: {what} is {least:g} for a joint, expected 0 or more. Correct it (--layout).")
    return found


def _per_joint(path: Path, what: str, values: Values, names: Sequence[str]) -> tuple[float, ...]:
    if isinstance(values, bool):
        raise PolicyError(f"{path}: {what} is {values}, expected numbers.")
    if isinstance(values, int | float):
        return (_number(path, what, values),) * len(names)
    if isinstance(values, Mapping):
        return tuple(_number(path, what, _matching(path, what, values, name)) for name in names)
    if isinstance(values, str) or len(values) != len(names):
        raise PolicyError(f"{path}: {what} has {len(values)} numbers for {len(names)} joints.")
    return tuple(_number(path, what, value) for value in values)


def completed(path: Path, what: str, values: Values, robot: RobotSpec) -> Values:
    """The same, and for joints that a mapping leaves out the robot's own numbers: what `rest: robot` means."""
    if not isinstance(values, Mapping):
        return values
    own = dict(zip(robot.joint_names, getattr(robot, what), strict=True))
    return {**values, **{name: own[name] for name in own if not _found(path, what, values, name)}}


def check_keys(path: Path, what: str, values: Values, names: Sequence[str]) -> None:
    """Raises PolicyError for a name or pattern that means no joint: a slip of the pen, whose number nobody would get.
    names: the robot's joints."""
    if not isinstance(values, Mapping):
        return
    idle = [key for key in values if not any(_found(path, what, {key: values[key]}, name) for name in names)]
    if idle:
        raise PolicyError(
            f"{path}: {what}: no joint is meant by '{str(idle[0])[:60]}', so its number would be used nowhere. "
            f"Correct it; the robot has {', '.join(names)}."
        )


def _matching(path: Path, what: str, values: Mapping[str, float], name: str) -> Any:
    found = _found(path, what, values, name)
    if len(set(found.values())) != 1:
        which, rest = f"several ({', '.join(map(str, found))})", ""
        if not found:
            which, rest = "no number", ", or `rest: robot` there if it is the robot's own"
        raise PolicyError(
            f"{path}: {what} gives joint '{name}' {which}. State it by the joint's name in the layout{rest}."
        )
    return next(iter(found.values()))


def _found(path: Path, what: str, values: Mapping[str, float], name: str) -> dict[str, float]:
    """The entries of a mapping that mean a joint: its name, or else the patterns that match it."""
    if name in values:
        return {name: values[name]}
    slow = [key for key in values if len(str(key)) > 200 or re.search(r"\)\s*[*+{?]", str(key))]
    if slow:  # such a pattern can take for ever
        raise PolicyError(
            f"{path}: {what} has the pattern '{str(slow[0])[:60]}'. Name the joints in the layout instead."
        )
    try:
        return {key: value for key, value in values.items() if re.fullmatch(str(key), name)}
    except re.error as error:
        raise PolicyError(f"{path}: {what} has a pattern that is none ({error}).") from error


def _number(path: Path, what: str, value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value) or abs(value) > 1e5:
        raise PolicyError(f"{path}: {what} is {str(value)[:60]}, expected finite numbers up to 1e5.")
    return float(value)


def ask(path: Path, contract: Contract, observed: bool = True) -> None:
    """Raises PolicyError that names all that the source does not state, and how to state it. observed: whether what the
    policy sees is stated."""
    missing = [*contract.missing(), *([] if observed else ["observation"])]
    if missing:
        wanted = "; ".join(f"{key} ({ASKED.get(key, OBSERVED)})" for key in missing)
        raise PolicyError(
            f"{path}: neither it nor what lies beside it says {wanted}. State them in a layout (--layout L.yaml)"
            f"{_of_rest(missing)}."
        )


def _of_rest(missing: Sequence[str]) -> str:
    """What `rest: robot` does for what is missing: nothing for a delay."""
    if missing == ["delay_seconds"]:
        return "; `rest: robot` does not say it: a delay is of the policy's training, the robot has none to take"
    but = ", but for delay_seconds: the robot has none to take" if "delay_seconds" in missing else ""
    return f"; `rest: robot` there says that what it leaves out is the robot's own{but}"
