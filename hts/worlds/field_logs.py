"""Logs that describe themselves: a runtime writes `logs/mappings/NAME.yaml` beside `logs/NAME.csv`.

It says which column is which channel, the clock, the gains and the policy that ran. What only a person knows, the
robot's mass, an idle level measured by hand and for how long a gauge may repeat itself, comes from the run's own
mapping and wins where it is there. What else the run's own says would be of no use there, so it is refused rather than
passed over.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from hts.contracts import Task
from hts.errors import ConfigError, RecordingError, unknown_name
from hts.explain import shortened
from hts.recordings.mapping import load_mapping

FOLDER = "mappings"
SECTIONS = {
    "channels": "keys and values (a channel's name: its columns and unit)",
    "recording": "keys and values (such as mass_kg: 13.2)",
}
OF_GAUGES = "frozen_real_seconds"
GAINS = {"kp": "a list of one gain a joint, N*m/rad", "kd": "a list of one gain a joint, N*m*s/rad"}


def described(logs: Path, name: str, own: Mapping[str, Any], own_path: Path) -> tuple[dict[str, Any], Path]:
    """The mapping of one log and where it lies: that beside it, completed by the run's own; the run's own if there is
    none. One beside it without `channels` adds what it says to the run's own. Raises RecordingError for either that is
    not built as a mapping is, see `check_sections`, and where the run's own tells of a second file, or of a level of a
    channel that is not in the log: see `_check_one_file`."""
    path = logs / FOLDER / f"{name}.yaml"
    check_sections(own_path, own)
    if path == own_path or not path.is_file():
        return dict(own), own_path
    mapping = _with_levels(load_mapping(path), own)
    check_sections(path, mapping)
    if not mapping.get("channels"):  # a person's few words of this one log, such as that the robot fell in it
        said = {**dict(own.get("recording") or {}), **dict(mapping.get("recording") or {})}
        return {**own, **mapping, "channels": dict(own.get("channels") or {}), "recording": said}, path
    _check_one_file(path, mapping, own, own_path)
    facts, stated = dict(mapping.get("recording") or {}), dict(own.get("recording") or {})
    facts |= {key: value for key, value in stated.items() if value is not None or key not in facts}
    gauges = {OF_GAUGES: own[OF_GAUGES]} if OF_GAUGES in own else {}
    return {**mapping, **gauges, "channels": dict(mapping.get("channels") or {}), "recording": facts}, path


def _with_levels(mapping: Mapping[str, Any], own: Mapping[str, Any]) -> dict[str, Any]:
    """A mapping with the idle levels of the run's own in place of its own, whatever those are: before it is checked,
    since a level that nobody could measure there is mended so."""
    found, stated = mapping.get("channels"), own.get("channels") or {}
    if not isinstance(found, Mapping):
        return dict(mapping)
    channels = dict(found)
    for channel, one in stated.items():
        level = one.get("idle") if isinstance(one, Mapping) else None
        if level is not None and isinstance(channels.get(channel), Mapping):
            channels[channel] = {**channels[channel], "idle": level}
    return {**mapping, "channels": channels}


def check_sections(path: Path, mapping: Mapping[str, Any]) -> None:
    """Raise RecordingError, one line with the file and the key, where a part of a mapping that is looked at before all
    of it is checked is not what it must be. path: of the mapping."""
    for key, what in SECTIONS.items():
        _check(path, key, mapping.get(key), Mapping, what)
    for channel, one in dict(mapping.get("channels") or {}).items():
        where = f"channels.{channel}"
        _check(path, where, one, Mapping, "keys and values (columns, unit)")
        _check(path, f"{where}.idle", (one or {}).get("idle"), (int, float), "a number, in the channel's unit")
    for key, what in GAINS.items():
        _check(path, f"recording.{key}", (mapping.get("recording") or {}).get(key), list, what)


def check_judged(task: Task, mapping: Mapping[str, Any], where: Path) -> None:
    """Raise ConfigError where the logs of a comparison lack a channel that tells whether the robot did its task."""
    channels = mapping.get("channels")
    for channel in task.channels:
        if isinstance(channels, Mapping) and channel not in channels:
            text = unknown_name("channel of this mapping", channel, channels)
            raise ConfigError(f"{where}: '{channel}' tells whether the robot did its task. {text}")


def check_of_all(path: Path, mapping: Mapping[str, Any]) -> None:
    """Raise RecordingError where the run's own mapping, which is of all logs, says what is true of one walk."""
    if (mapping.get("recording") or {}).get("fell"):
        raise RecordingError(
            f"{path}: recording.fell: is said of all logs, of the reference's too. Say it of those in which the robot "
            f"fell, each in logs/{FOLDER}/NN.yaml beside its log (`recording: {{fell: true}}`), and delete it here."
        )


def _check(path: Path, key: str, found: Any, kind: type | tuple[type, ...], expected: str) -> None:
    """Empty and left out pass: what is needed is asked for later."""
    if found is None or (isinstance(found, kind) and not isinstance(found, bool)):
        return
    raise RecordingError(
        f"{path}: {key}: expected {expected}, found {shortened(found)}. Write it so, or delete the line if it says "
        "nothing."
    )


def _check_one_file(path: Path, mapping: Mapping[str, Any], own: Mapping[str, Any], own_path: Path) -> None:
    """Raise RecordingError if the run's own mapping tells of a sensor that the mapping beside the log knows nothing
    of: then one of the two has to describe all of it."""
    what = [f"`{key}`" for key in ("files", "join") if own.get(key) and not mapping.get(key)]
    for channel, one in dict(own.get("channels") or {}).items():
        if channel not in (mapping.get("channels") or {}) and isinstance(one, Mapping) and one.get("idle") is not None:
            what.append(f"an idle level of '{channel}'")
    if what:
        raise RecordingError(
            f"{own_path}: says {' and '.join(what)}, but the log has a mapping of its own, {path}, which knows of no "
            "such thing and is what counts. Put the other sensor's files beside the log and describe them there, or "
            f"describe everything in {own_path.name} and delete {path.parent}."
        )


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


def check_row(where: Path, facts: Mapping[str, Any], asked: Mapping[str, Any]) -> None:
    """Raise RecordingError if the mapping beside a log says that it is of another row than the one that is asked for:
    of another bundle, block, role or schedule. asked: `session`, `block`, `role` and `schedule` (as JSON); what a
    mapping does not say is believed. Read on as this row's, a walk at one speed would count for another one."""
    said = {key: facts[key] for key in ("session", "block", "role") if facts.get(key) is not None}
    other = [f"{key} {shortened(found)}, not {asked[key]}" for key, found in said.items() if found != asked[key]]
    schedule, wanted = facts.get("schedule"), asked["schedule"]["commands"]
    commands = schedule.get("commands") if isinstance(schedule, Mapping) else None
    if isinstance(commands, Sequence) and not _agree(commands, wanted):
        other.append(f"commands {shortened(list(commands))}, not {shortened(wanted)}")
    if other:
        raise RecordingError(
            f"{where}: says that its log is of {'; '.join(other)}, as is asked for here. It is the log of another row "
            "or of another bundle: put there the log of this row, or record the row again."
        )


def _agree(commands: Sequence[Any], wanted: Sequence[Mapping[str, Any]]) -> bool:
    """Whether the commands of a schedule are those wanted; what one leaves out, or leaves without end, agrees."""
    if len(commands) != len(wanted):
        return False
    return all(
        isinstance(found, Mapping) and all(found.get(key) in (None, math.inf, value) for key, value in one.items())
        for found, one in zip(commands, wanted, strict=True)
    )


def left_behind(logs: Path, name: str) -> str:
    """A sentence for a log of which a runtime may have written a mapping that was not copied with it."""
    return (
        f" Or, if the robot's runtime recorded row {name}, copy what it wrote beside the log as well: there is no "
        f"{logs / FOLDER / name}.yaml."
    )


def check_weighed(where: Path, mapping: Mapping[str, Any], hint: str = "") -> None:
    """Raise RecordingError if the mass, which the template leaves to be filled in, is still empty. where: of the
    mapping; hint: a sentence for the end, or ""."""
    facts = mapping.get("recording")
    if isinstance(facts, Mapping) and "mass_kg" in facts and facts["mass_kg"] is None:
        raise RecordingError(
            f"{where}: recording.mass_kg is still empty. Weigh the robot as it walks and write the kilograms there, or "
            f"delete the line if nothing that is measured needs them.{hint}"
        )
