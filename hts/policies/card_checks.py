"""Whether the card of a policy can be one: it comes from a file that anybody may have written, and drives motors."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from hts.errors import PolicyError
from hts.explain import shortened

MOST_JOINTS, MOST_LAYERS, MOST_UNITS, MOST_PARTS = 1000, 20, 65_536, 1000
LARGEST_OBSERVATION = 1_000_000  # numbers, history included
LARGEST = 1e5  # of anything in SI units that a joint, a gain or a rate can be
PER_JOINT = ("default_pose", "action_scale", "kp", "kd", "exploration_std")
NOT_NEGATIVE = ("kp", "kd", "exploration_std")


def check_card(card: Mapping[str, Any], path: Path) -> None:
    """Raises PolicyError, one line with the key, for a card with missing keys, wrong lengths,
    or absurd or non-finite numbers."""
    if not isinstance(card, Mapping):
        raise PolicyError(
            f"{path}: not a policy card (it is a {type(card).__name__}). Copy or export the policy again."
        )
    needed = ("joint_names", "default_pose", "action_scale", "kp", "kd", "control_rate_hz", "observation")
    missing = [key for key in needed if key not in card]
    if missing:
        raise PolicyError(f"{path}: not a policy card (it has no '{missing[0]}'). Copy or export the policy again.")
    fault = _fault(card)
    if fault:
        raise PolicyError(f"{path}: its card says {fault}. Do not run it; export the policy again.")


def _fault(card: Mapping[str, Any]) -> str | None:
    """What is wrong with it, or None."""
    joints = card["joint_names"]
    if not _is_list(joints, MOST_JOINTS) or not all(isinstance(name, str) and name for name in joints):
        return f"joint_names {shortened(joints)}, expected a list of names"
    if len(set(joints)) != len(joints):
        return f"joint_names {shortened(joints)}, in which one stands twice"
    for key in PER_JOINT:
        values = card.get(key, ())
        if key == "exploration_std" and not values:
            continue
        if not _is_list(values, MOST_JOINTS) or len(values) != len(joints):
            return f"{key} {shortened(values)}, expected {len(joints)} numbers, one per joint"
        low = 0.0 if key in NOT_NEGATIVE else -LARGEST
        for joint, value in zip(joints, values, strict=True):
            if not _is_number(value, low):
                return f"{key} {shortened(value)} of '{joint}', expected a number of {low:g} to {LARGEST:g}"
    rate = card["control_rate_hz"]
    if not _is_number(rate, 0.0) or rate == 0:
        return f"control_rate_hz {shortened(rate)}, expected a number above 0"
    return _fault_of_sizes(card)


def _fault_of_sizes(card: Mapping[str, Any]) -> str | None:
    parts = card["observation"]
    if not _is_list(parts, MOST_PARTS) or not all(isinstance(part, Mapping) for part in parts):
        return f"observation {shortened(parts)}, expected a list of parts with name and size"
    for part in parts:
        if not isinstance(part.get("name"), str) or not _is_count(part.get("size"), LARGEST_OBSERVATION):
            return f"observation part {shortened(dict(part))}, expected a name and a size of at least 1"
    history = card.get("history", 1)
    if not _is_count(history, LARGEST_OBSERVATION):
        return f"history {shortened(history)}, expected a number of observations"
    if history * sum(part["size"] for part in parts) > LARGEST_OBSERVATION:
        return f"an observation of more than {LARGEST_OBSERVATION:,} numbers"
    if not _is_count(card.get("critic_observation_size", 1), LARGEST_OBSERVATION):
        return f"critic_observation_size {shortened(card['critic_observation_size'])}, expected a number of entries"
    hidden = card.get("hidden", ())
    if not isinstance(hidden, list | tuple) or len(hidden) > MOST_LAYERS:
        return f"hidden {shortened(hidden)}, expected at most {MOST_LAYERS} layers"
    if not all(_is_count(units, MOST_UNITS) for units in hidden):
        return f"hidden {shortened(hidden)}, expected layers of 1 to {MOST_UNITS:,} units"
    return None


def _is_list(value: Any, most: int) -> bool:
    return isinstance(value, list | tuple) and 0 < len(value) <= most


def _is_number(value: Any, low: float) -> bool:
    number = isinstance(value, int | float) and not isinstance(value, bool)
    return number and math.isfinite(value) and low <= value <= LARGEST


def _is_count(value: Any, most: int) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and 1 <= value <= most
