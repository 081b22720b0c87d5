"""What of an imported policy has been shown by its log, what a person vouches for, and what nobody has shown yet."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from hts.contracts import RobotSpec
from hts.errors import ConfigError, PolicyError, unknown_name
from hts.policies.contract import ASKED, Contract, known_joints, per_joint

ITEMS = {
    "actions": "the network gives the original's actions",
    "observation": "each number that it observes is what the layout says",
    "joint_order": "action and joint belong together",
    "default_pose": "the targets where its actions are zero",
    "action_scale": "how far an action moves a target",
    "gains": "kp and kd of the joint controllers",
    "delay": "from observation to the target's effect",
    "control_rate": "how often it is asked",
}
"""What has to be known of a policy before it moves a robot."""

PROVEN, NOT_PROVEN, DIFFERS, ACCEPTED = "proven", "not proven", "differs", "accepted"
STATES = (PROVEN, NOT_PROVEN, DIFFERS, ACCEPTED)
HARMLESS_CLIP = 20.0  # action units: no policy that walks goes there
RATE_TOLERANCE = 0.01  # relative


@dataclass(frozen=True)
class State:
    """Of one item: one of STATES, why, and who accepted it."""

    state: str
    why: str
    by: str = ""


States = Mapping[str, State]


def before_replay(path: Path, contract: Contract, robot: RobotSpec) -> dict[str, State]:
    """What is known without a log: nothing is proven; what differs from the robot is said."""
    states = {
        "actions": State(NOT_PROVEN, "no recorded action was replayed"),
        "observation": State(NOT_PROVEN, "no recorded observation was compared with what was measured"),
    }
    keys = {
        "joint_order": ("joint_names",),
        "default_pose": ("default_pose",),
        "action_scale": ("action_scale",),
        "gains": ("kp", "kd"),
        "delay": ("delay_seconds",),
        "control_rate": ("control_rate_hz",),
    }
    for item, asked in keys.items():
        said = sorted({contract.said_by.get(key, "") for key in asked if getattr(contract, key) is not None} - {""})
        silent = [key for key in asked if getattr(contract, key) is None]
        if item == "delay" and silent:
            why = "nobody states what it was trained with"
        elif silent:
            why = "nobody states it; taken to be the robot's own"
        else:
            why = f"stated by {' and '.join(said) or 'the caller'}; no log was replayed"
        states[item] = State(NOT_PROVEN, why)
    different = gains_that_differ(path, contract, robot)
    if different:
        states["gains"] = State(DIFFERS, different)
    clip = contract.action_clip
    if clip is not None and clip < HARMLESS_CLIP:
        states["action_clip"] = State(
            DIFFERS, f"the original keeps its actions within {clip:g} either way, hts does not"
        )
    return states


def gains_that_differ(path: Path, contract: Contract, robot: RobotSpec) -> str:
    """In words, the first joint whose gains are not the robot's; empty if none."""
    names = known_joints(path, contract, robot)
    for key, unit in (("kp", "N*m/rad"), ("kd", "N*m*s/rad")):
        values = getattr(contract, key)
        if values is None:
            continue
        theirs = dict(zip(names, per_joint(path, key, values, names), strict=True))
        for name, own in zip(robot.joint_names, getattr(robot, key), strict=True):
            if not math.isclose(theirs[name], own, rel_tol=1e-3, abs_tol=1e-9):
                return (
                    f"trained with {key} {theirs[name]:.4g} {unit} at '{name}', robot '{robot.name}' has {own:.4g}: "
                    "it will move otherwise; give the robot these gains, or see whether it still walks"
                )
    return ""


def check_rate(path: Path, contract: Contract, robot: RobotSpec) -> None:
    """Raises PolicyError for a policy that was asked more or less often than the robot asks."""
    rate = contract.control_rate_hz
    if rate is not None and not math.isclose(rate, robot.control_rate_hz, rel_tol=RATE_TOLERANCE):
        raise PolicyError(
            f"{path}: it was asked {rate:g} times a second, robot '{robot.name}' asks {robot.control_rate_hz:g} times. "
            "No policy bears that: train it at the robot's rate, or give the robot another control_rate_hz."
        )


# ------------------------------------------------------------------------------------------------- on a card


def written(contract: Contract) -> dict[str, Any]:
    """What the source says, for the card."""
    keys = [*ASKED, "action_clip"]
    found = {key: getattr(contract, key) for key in keys if getattr(contract, key) is not None}
    plain = {
        key: dict(value) if isinstance(value, Mapping) else list(value) if isinstance(value, list | tuple) else value
        for key, value in found.items()
    }
    return {**plain, "said_by": dict(contract.said_by)}


def as_card(states: States) -> dict[str, dict[str, str]]:
    """The states as a card holds them, under `made.proof`."""
    return {
        item: {"state": one.state, "why": one.why, **({"by": one.by} if one.by else {})} for item, one in states.items()
    }


def of_card(made: Mapping[str, Any]) -> dict[str, State]:
    """Back from a card; what cannot be read there counts as not proven."""
    found = made.get("proof")
    if not isinstance(found, Mapping):
        return {}
    states = {}
    for item, one in found.items():
        if isinstance(one, Mapping) and one.get("state") in STATES and (one["state"] != ACCEPTED or one.get("by")):
            states[str(item)] = State(str(one["state"]), str(one.get("why", "")), str(one.get("by", "")))
        else:
            states[str(item)] = State(NOT_PROVEN, "its card does not say how it was shown")
    return states


def unproven(card: Any) -> list[str]:
    """What nobody has shown or vouched for of the policy with this card (a PolicyCard, or its JSON as a mapping).

    Empty for a policy that was trained here. A policy made from an imported one (`made.start`) is as unproven as that.
    """
    made = card.get("made") if isinstance(card, Mapping) else card.made
    open_items: list[str] = []
    seen = 0
    while isinstance(made, Mapping) and seen < 100:
        seen += 1
        states = of_card(made)
        foreign = made.get("kind") in ("rsl_rl", "layers", "onnx")
        if foreign or "proof" in made:
            wanted = [*ITEMS, *(item for item in states if item not in ITEMS)]
            open_items += [
                item for item in wanted if states.get(item, State(NOT_PROVEN, "")).state not in (PROVEN, ACCEPTED)
            ]
        start = made.get("start")
        made = start.get("made") if isinstance(start, Mapping) else None
    return list(dict.fromkeys(open_items))


def inherited(made: Mapping[str, Any]) -> dict[str, Any]:
    """What the card of a policy that starts from another one takes over from that one's `made`."""
    kept = {key: made[key] for key in ("proof", "source") if key in made}
    if "proof" not in made and unproven({"made": made}):
        kept["proof"] = as_card({item: State(NOT_PROVEN, "imported before proofs were kept") for item in ITEMS})
    return kept


def accepted(states: States, items: Sequence[str], by: str) -> dict[str, State]:
    """The states with some items on a person's word. Raises ConfigError for a wrong item or no name."""
    if items and not by.strip():
        raise ConfigError("--accept needs the name of the person who vouches for it: --by NAME.")
    if not by.isprintable() or len(by) > 100:
        raise ConfigError("--by: expected a name of up to 100 printable characters.")
    done = dict(states)
    for item in items:
        if item not in done:
            raise ConfigError("--accept: " + unknown_name("item", item, done))
        if done[item].state not in (PROVEN, ACCEPTED):
            done[item] = replace(done[item], state=ACCEPTED, by=by.strip())
    return done
