"""Logs that describe themselves: a runtime writes `logs/mappings/NAME.yaml` beside `logs/NAME.csv`.

It says which column is which channel, the clock, the gains and the policy that ran. What only a person knows, the
robot's mass and an idle level measured by hand, comes from the run's own mapping and wins where it is there.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from hts.errors import RecordingError
from hts.recordings.mapping import load_mapping

FOLDER = "mappings"


def described(logs: Path, name: str, own: Mapping[str, Any], own_path: Path) -> tuple[dict[str, Any], Path]:
    """The mapping of one log and where it lies: that beside it, completed by the run's own; the run's own if there is
    none."""
    path = logs / FOLDER / f"{name}.yaml"
    if not path.is_file():
        return dict(own), own_path
    mapping = load_mapping(path)
    channels = dict(mapping.get("channels") or {})
    for channel, one in dict(own.get("channels") or {}).items():
        level = one.get("idle") if isinstance(one, Mapping) else None
        if level is not None and isinstance(channels.get(channel), Mapping):
            channels[channel] = {**channels[channel], "idle": level}
    facts = dict(mapping.get("recording") or {})
    facts |= {key: value for key, value in dict(own.get("recording") or {}).items() if value is not None}
    return {**mapping, "channels": channels, "recording": facts}, path


def check_ran(where: Path, facts: Mapping[str, Any], card: SimpleNamespace, policy: str) -> None:
    """Raise RecordingError if the mapping says that another policy ran than the one that was asked for, or with other
    gains. card: of that policy; a mapping that says neither is believed."""
    found, expected = facts.get("policy_hash"), card.policy_hash
    for key in ("kp", "kd"):
        if facts.get(key) is not None and list(facts[key]) != list(getattr(card, key)):
            raise RecordingError(
                f"{where}: {key} {str(list(facts[key]))[:40]}… was sent, {policy} was trained with "
                f"{str(list(getattr(card, key)))[:40]}… Record the row again with the policy's own gains."
            )
    if found and found != expected:
        raise RecordingError(
            f"{where}: policy {str(found)[:12]}… ran, asked for was {policy} ({expected[:12]}…). Put the log of that "
            "policy here, or record the row again."
        )
