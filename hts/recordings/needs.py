"""What is needed of a log or a recording: an objective's inputs, its target, and what else its score reads; and what
tells whether the robot did its task."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from hts.errors import ConfigError, RecordingError, unknown_name
from hts.recordings.recording import Series
from hts.units import conversion, same_unit

RATE_TOLERANCE = 0.01
"""Between the rate that a recording states and that at which the robot's policies act."""

if TYPE_CHECKING:
    from hts.channels import Channel
    from hts.contracts import Objective, Robot, RobotSpec
    from hts.recordings.recording import Recording


def check_mapping(objective: Objective, mapping: Mapping[str, Any], where: object) -> None:
    """A mapping of log columns has every channel that the objective needs. Raises ConfigError naming the first that
    it lacks; where: what the mapping is called in it."""
    channels = mapping.get("channels")
    for wanted in (*objective.inputs, *(channel.name for channel in objective.real_channels)):
        if isinstance(channels, Mapping) and wanted not in channels:
            text = unknown_name("channel of this mapping", wanted, channels)
            raise ConfigError(f"{where}: objective '{objective.name}' needs '{wanted}'. {text}")


def check_measured(objective: Objective, mapping: Mapping[str, Any], own: Mapping[str, Channel], where: object) -> None:
    """The mapping does not say `real: false`, without an idle level, of what the objective is to learn.

    own: the robot's channels in simulation, which need no level; where: what the mapping is called in messages. Raises
    ConfigError.
    """
    channels, target = mapping.get("channels"), objective.real_channels[0].name
    one = channels.get(target) if isinstance(channels, Mapping) else None
    if isinstance(one, Mapping) and one.get("real") is False and one.get("idle") is None and target not in own:
        raise ConfigError(
            f"{where}: channels.{target}: says real: false, but objective '{objective.name}' measures it and needs its "
            "idle level: read it off with electronics on and motors idle, and say that in the place of real: false."
        )


def as_declared(objectives: Iterable[Objective], mapping: Mapping[str, Any]) -> dict[str, Any]:
    """The mapping, in which a channel that an objective says may be constant may be so, unless the mapping says no."""
    channels = mapping.get("channels")
    if not isinstance(channels, Mapping):
        return dict(mapping)
    may = {channel.name for one in objectives for channel in one.real_channels if channel.may_be_constant}
    found = {
        name: {"may_be_constant": True, **one} if name in may and isinstance(one, Mapping) else one
        for name, one in channels.items()
    }
    return {**mapping, "channels": found}


def in_units_of(
    objectives: Sequence[Objective], recording: Recording, own: Mapping[str, Channel], where: object
) -> Recording:
    """The recording with each real channel of the objectives, and its idle level, in the unit that they ask for.

    own: the robot's channels, which keep its units; where: what the mapping is called in messages. What is converted is
    in the notes. Raises ConfigError for a unit of another quantity, another shape, or two objectives that disagree.
    """
    channels, idle, notes = dict(recording.channels), dict(recording.idle), []
    settled: dict[str, tuple[str, str]] = {}
    for objective in objectives:
        for wanted in objective.real_channels:
            series = channels.get(wanted.name)
            if series is None:  # left out by the reader; said elsewhere
                continue
            found, unit = series.channel, series.channel.unit
            begin = f"{where}: '{wanted.name}'"
            if found.shape != wanted.shape:
                raise ConfigError(
                    f"{begin} has shape {found.shape}, objective '{objective.name}' needs {wanted.shape}. Correct its "
                    "`columns`."
                )
            scale, offset = _converted(begin, unit, wanted.unit, objective.name)
            known = settled.setdefault(wanted.name, (wanted.unit, objective.name))
            if (scale, offset) == (1.0, 0.0):
                continue
            if known[0] != wanted.unit or wanted.name in own:
                other = f"objective '{known[1]}'" if known[0] != wanted.unit else "the robot"
                raise ConfigError(
                    f"{begin} is in {unit} for {other}, objective '{objective.name}' needs {wanted.unit}. They cannot "
                    "share recordings: import for one of them."
                )
            values = scale * series.values.astype("float64") + offset
            channels[wanted.name] = Series(replace(found, unit=wanted.unit), values)
            if wanted.name in idle:
                idle[wanted.name] = scale * idle[wanted.name] + offset
            notes.append(f"{wanted.name} {unit} to {wanted.unit}")
    if not notes:
        return recording
    told = {**recording.notes, "units_converted": ", ".join(notes)}
    return recording.replace(channels=channels, idle=idle, notes=told)


def levels_in_units_of(
    objectives: Sequence[Objective], mapping: Mapping[str, Any], where: object
) -> dict[str, float | None]:
    """Idle level of each measured channel of a mapping, in the units that `in_units_of` brings its recordings to; None
    where it is still to be written. where: as there. Raises ConfigError as it does."""
    channels = mapping.get("channels") or {}
    found = {name: one for name, one in channels.items() if isinstance(one, Mapping) and "idle" in one}
    levels = {name: one["idle"] for name, one in found.items()}
    for objective in objectives:
        for wanted in objective.real_channels:
            one = found.get(wanted.name, {})
            if one.get("idle") is None or one.get("unit") is None:
                continue
            scale, offset = _converted(f"{where}: '{wanted.name}'", str(one["unit"]), wanted.unit, objective.name)
            levels[wanted.name] = scale * one["idle"] + offset
    return levels


def _converted(begin: str, unit: str, wanted: str, objective: str) -> tuple[float, float]:
    try:
        return conversion(unit, wanted)
    except RecordingError as error:
        raise ConfigError(
            f"{begin} is in {unit}, objective '{objective}' needs {wanted}: {error} Correct its unit, or its columns."
        ) from error


def check_recorded(objectives: Iterable[Objective], recordings: Iterable[Recording], *, inputs: bool = False) -> None:
    """Every real channel that the objectives score is recorded, in its unit and shape; and with `inputs` each channel
    that their measurement models read.

    Raises RecordingError as soon as recordings come from a world, before anything is spent on them.
    """
    asked = list(objectives)
    for recording in recordings:
        for objective in asked:
            for channel in objective.real_channels:
                _check_one(recording, f"objective '{objective.name}' measures", channel.name, channel)
            for name in objective.inputs if inputs else ():
                if name not in recording.channels:
                    text = unknown_name("channel of this recording", name, recording.channels)
                    raise RecordingError(
                        f"{_begin(recording)} objective '{objective.name}'s model reads '{name}', which was not "
                        f"recorded. {text}"
                    )


def check_judged_by(recordings: Iterable[Recording], robot: Robot) -> None:
    """Raise RecordingError where a channel by which the robot's task is judged was not recorded, or in another unit or
    shape than the robot's own: km/h would be judged as m/s. First data are not judged, so they may lack it."""
    own = robot.channels()
    for recording in recordings:
        for name in robot.task().channels:
            if name in recording.channels or recording.role != "collection":
                _check_one(recording, "the robot's task is judged by", name, own.get(name))


def unjudged(recordings: Sequence[Recording], robot: Robot) -> str | None:
    """One line about logs without a channel by which the robot's task is judged, though the robot gives it: what they
    are good for all the same. None where all have it."""
    task = robot.task()
    wanted = [name for name in task.channels if name in robot.channels()]
    without = [one for one in recordings if any(name not in one.channels for name in wanted)]
    if not without:
        return None
    name = next(name for name in wanted if any(name not in one.channels for one in without))
    who = "the log has" if len(recordings) == 1 else f"{len(without)} of {len(recordings)} recordings have"
    held = " or holds a speed" if task.can_hold else ""
    return (
        f"note: {who} no '{name}', so nothing tells the {task.quantity}. A fit and first data do without it; what "
        f"compares policies{held} needs it."
    )


def check_rate(recordings: Iterable[Recording], spec: RobotSpec) -> None:
    """Raise RecordingError for a recording of another rate than that at which the robot's policies act: a model that
    was fitted to it would be asked once a control step all the same, and take one for as long as the other."""
    for recording in recordings:
        if abs(recording.rate_hz / spec.control_rate_hz - 1.0) > RATE_TOLERANCE:
            raise RecordingError(
                f"World '{recording.world}', policy {recording.policy_hash[:8]}: recorded at {recording.rate_hz:g} Hz, "
                f"robot '{spec.name}' acts at {spec.control_rate_hz:g} Hz. Read the log at that rate (rate_hz in its "
                "mapping)."
            )


def _begin(recording: Recording) -> str:
    return f"World '{recording.world}', policy {recording.policy_hash[:8]}:"


def _check_one(recording: Recording, who: str, name: str, channel: Channel | None) -> None:
    """who: begins what is said of it; channel: as it should be, None where nobody states its unit and shape."""
    what = f"{_begin(recording)} {who} '{name}'"
    if name not in recording.channels:
        text = unknown_name("channel of this recording", name, recording.channels)
        raise RecordingError(f"{what}, which was not recorded. {text}")
    found = recording.channels[name].channel
    if channel is None:
        return
    if found.shape != channel.shape:
        raise RecordingError(
            f"{what} with shape {channel.shape}, recorded is {found.shape}. Record or import it in that shape."
        )
    if not same_unit(found.unit, channel.unit):
        raise RecordingError(
            f"{what} in {channel.unit}, recorded is {found.unit}. Record or import it in {channel.unit}."
        )
