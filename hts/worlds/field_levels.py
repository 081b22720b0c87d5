"""Idle levels and masses that the rows of one comparison state: what is alike in all of them must be said alike.

A row's idle level is taken off that row alone, and its mass divides that row alone. So where policy and reference state
different ones, the difference counts as a saving, or as a loss, however they walked.

Levels are compared by their ratio. That of temperatures says nothing, since the zero of degC is arbitrary: of these the
difference is held against what walking adds to the level.
"""

from __future__ import annotations

import copy
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from hts import units
from hts.channels import Channel
from hts.contracts import Installed, JointMotors, Objective, Robot
from hts.errors import ConfigError, RecordingError
from hts.recordings.recording import Recording

IDLE_NOTED = 0.03
"""Share by which idle levels may differ before it is said: two readings of ten seconds each agree better, and a
runtime asks the same of the levels before and after a visit."""
IDLE_REFUSED = 0.15
"""Share by which they may differ at all. Over a day, with the state of charge and the heat of the electronics, a level
moved by 11 %; more than that is another reading, or electronics that do something else."""
IDLE_UNSEEN = 0.005
"""What is less than this share of what walking adds to the level changes no result, whatever share of the level it is:
a level of about 0 is a sensor's offset, which is never read alike twice."""
MASS_REFUSED = 0.02
"""Share by which masses may differ: a sensor or a pack more is seen, two scales agree better. One robot walks all
rows of a comparison as it is."""
NOTE = "idle_differs"
"""Note of the recordings of a comparison whose rows state idle levels further apart than IDLE_NOTED."""


def real_channels(objectives: Iterable[Objective], registry: Installed, robot: Robot) -> list[Channel]:
    """What only the robot gives for the objectives: their own real channels, and what else their instruments tell with
    a level."""
    found: dict[str, Channel] = {}
    for objective in objectives:
        found |= {channel.name: channel for channel in objective.real_channels}
        found |= {channel.name: channel for channel in _with_levels(objective, registry, robot)}
    return list(found.values())


def measured_from_idle(objectives: Iterable[Objective], registry: Installed, robot: Robot) -> list[str]:
    """Names of the channels whose idle level an objective needs: its target, and what its instrument has a level of."""
    own, found = robot.channels(), dict[str, None]()
    for objective in objectives:
        for channel in (objective.target, *_with_levels(objective, registry, robot)):
            found |= {channel.name: None} if channel.name not in own else {}
    return list(found)


def _with_levels(objective: Objective, registry: Installed, robot: Robot) -> list[Channel]:
    """Channels that the objective's instrument states an idle level of; some tell there what else a score needs."""
    if objective.instrument is None:
        return []
    instrument = registry.make_instrument(objective.instrument, {}, _with_motors(robot))
    levels = instrument.idle()
    return [channel for channel in instrument.channels if channel.name in levels]


def _with_motors(robot: Robot) -> Robot:
    """The robot, with motor constants of 1 where nobody wrote them down: of the instrument only the names of its
    channels are taken, and a machine that is measured needs no constants."""
    if robot.spec.motors is not None:
        return robot
    ones, made = (1.0,) * robot.spec.num_joints, copy.copy(robot)
    made.spec = replace(robot.spec, motors=JointMotors(ones, ones, ones))
    return made


def check_stated(needed: Iterable[str], mapping: Mapping[str, Any], where: Path, own: Path, hint: str = "") -> None:
    """Raise ConfigError for a channel of `needed` that the mapping has without an idle level, as the template leaves it
    and as `real: false` would let it pass: it would be missed when the robot has walked, at the first comparison.

    where: of the mapping; own: the run's own; hint: a sentence for the end, or "".
    """
    for name in needed:
        one = (mapping.get("channels") or {}).get(name)
        if isinstance(one, Mapping) and one.get("idle") is None:
            also = "" if where == own else f", or for all rows in {own}"
            raise ConfigError(
                f"{where}: channels.{name}.idle is not stated, and what '{name}' shows is counted from there. Read the "
                f"level off with electronics on and motors idle, and write it there{also}"
                f"{'; real: false does not stand for it' if one.get('real') is False else ''}.{hint}"
            )


def with_one_level(
    recordings: Sequence[Recording], names: Sequence[str], mappings: Sequence[Path], own: Path
) -> list[Recording]:
    """The recordings, with a NOTE where rows of one session state idle levels that differ: it is among the doubts that
    whoever stores recordings tells of.

    names: of the rows; mappings: where each row's level and mass stand; own: the run's own mapping, which wins over
    them. Raises RecordingError, one line, where levels or masses differ by more than IDLE_REFUSED or MASS_REFUSED.
    """
    sessions: dict[str, list[int]] = {}
    for number, recording in enumerate(recordings):
        sessions.setdefault(recording.session, []).append(number)
    found = list(recordings)
    for rows in sessions.values():
        _check_mass(rows, recordings, names, mappings, own)
        said = _idle_levels(rows, recordings, names, mappings, own)
        if said:
            text = (
                "; ".join(said) + ". Where an objective takes the idle level off, this goes straight into net savings"
            )
            for row in rows:
                found[row] = found[row].replace(notes={**found[row].notes, NOTE: text})
    return found


def _idle_levels(
    rows: Sequence[int],
    recordings: Sequence[Recording],
    names: Sequence[str],
    mappings: Sequence[Path],
    own: Path,
) -> list[str]:
    """What is to be said of the idle levels of the rows of one session, a few words a channel."""
    said = []
    for channel in sorted({name for row in rows for name in recordings[row].idle}):
        levels = {row: recordings[row].idle[channel] for row in rows if channel in recordings[row].idle}
        low, high = _ends(levels)
        difference = levels[high] - levels[low]
        walking = float(np.mean([_added(recordings[row], channel) for row in levels]))
        if difference <= IDLE_UNSEEN * walking:
            continue
        unit = recordings[low].channels[channel].channel.unit
        by_ratio, share = not units.is_temperature(unit), difference / walking if walking > 0 else float("inf")
        apart = _apart(levels[low], levels[high]) if by_ratio else share
        if apart > IDLE_REFUSED:
            unlike = _unlike(f"channels.{channel}.idle", levels, f" {unit}", names, mappings)
            raise RecordingError(
                f"{unlike} {IDLE_REFUSED:.0%}{'' if by_ratio else ' of what walking adds to it'} apart, since the "
                "difference goes straight into net savings. Measure it once more and walk all rows of session "
                f"{recordings[low].session} anew, or, if one of the two was misread, state the level of all rows in "
                f"{own}."
            )
        if apart > IDLE_NOTED:
            said.append(
                f"session {recordings[low].session}: the idle level of '{channel}' is {levels[low]:.4g} {unit} in row "
                f"{names[low]} and {levels[high]:.4g} {unit} in row {names[high]} ("
                f"{f'{apart:.1%} apart, ' if by_ratio else ''}{min(share, 1.0):.1%} of what walking adds to it)"
            )
    return said


def _check_mass(
    rows: Sequence[int],
    recordings: Sequence[Recording],
    names: Sequence[str],
    mappings: Sequence[Path],
    own: Path,
) -> None:
    masses = {row: mass for row in rows if (mass := recordings[row].mass_kg) is not None}
    if not masses:
        return
    low, high = _ends(masses)
    if _apart(masses[low], masses[high]) > MASS_REFUSED:
        unlike = _unlike("recording.mass_kg", masses, "", names, mappings)
        raise RecordingError(
            f"{unlike} {MASS_REFUSED:.0%} apart. Weigh the robot as it walks and state that mass in {own}, or, if it "
            f"carried something in one of them alone, walk all rows of session {recordings[low].session} anew."
        )


def _ends(found: Mapping[int, float]) -> tuple[int, int]:
    """The rows of the smallest and of the largest number."""
    return min(found, key=lambda row: found[row]), max(found, key=lambda row: found[row])


def _unlike(what: str, found: Mapping[int, float], unit: str, names: Sequence[str], mappings: Sequence[Path]) -> str:
    """How a refusal of numbers that are too far apart begins, up to by how much they may be: the row of the two ends
    that is further from most of the rows, then the other one."""
    low, high = _ends(found)
    middle = float(np.median(list(found.values())))
    odd, other = (low, high) if middle - found[low] > found[high] - middle else (high, low)
    return (
        f"{mappings[odd]}: {what} is {found[odd]:.4g}{unit} in row {names[odd]}, but {found[other]:.4g}{unit} in row "
        f"{names[other]}, with which it is compared; expected at most"
    )


def _added(recording: Recording, channel: str) -> float:
    """What walking adds to the idle level of a channel."""
    return abs(float(recording.values(channel).mean(dtype=np.float64)) - recording.idle[channel])


def _apart(low: float, high: float) -> float:
    """By what share of the smaller one two numbers differ; infinite about 0."""
    smaller = min(abs(low), abs(high))
    if low == high:
        return 0.0
    return (high - low) / smaller if smaller > 0 and low * high > 0 else float("inf")
