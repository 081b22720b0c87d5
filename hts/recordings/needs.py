"""What an objective needs of a log or a recording: its inputs, its target, and what else its score reads."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

from hts.errors import ConfigError, RecordingError, unknown_name
from hts.units import conversion

if TYPE_CHECKING:
    from hts.channels import Channel
    from hts.contracts import Objective
    from hts.recordings.recording import Recording


def check_mapping(objective: Objective, mapping: Mapping[str, Any], where: object) -> None:
    """A mapping of log columns has every channel that the objective needs. Raises ConfigError naming the first that
    it lacks; where: what the mapping is called in it."""
    channels = mapping.get("channels")
    for wanted in (*objective.inputs, *(channel.name for channel in objective.real_channels)):
        if isinstance(channels, Mapping) and wanted not in channels:
            text = unknown_name("channel of this mapping", wanted, channels)
            raise ConfigError(f"{where}: objective '{objective.name}' needs '{wanted}'. {text}")


def check_recorded(objectives: Iterable[Objective], recordings: Iterable[Recording]) -> None:
    """Every real channel that the objectives score is recorded, in its unit and shape.

    Raises RecordingError as soon as recordings come from a world, before anything is spent on them.
    """
    wanted = [(objective, channel) for objective in objectives for channel in objective.real_channels]
    for recording in recordings:
        for objective, channel in wanted:
            _check_one(recording, objective.name, channel)


def _check_one(recording: Recording, objective: str, channel: Channel) -> None:
    where = f"World '{recording.world}', policy {recording.policy_hash[:8]}: objective '{objective}'"
    if channel.name not in recording.channels:
        text = unknown_name("channel of this recording", channel.name, recording.channels)
        raise RecordingError(f"{where} measures '{channel.name}', which was not recorded. {text}")
    found = recording.channels[channel.name].channel
    if found.shape != channel.shape:
        raise RecordingError(
            f"{where} measures '{channel.name}' with shape {channel.shape}, recorded is {found.shape}."
        )
    if found.unit != channel.unit and conversion(found.unit, channel.unit) != (1.0, 0.0):
        raise RecordingError(
            f"{where} measures '{channel.name}' in {channel.unit}, recorded is {found.unit}. Record or import it in "
            f"{channel.unit}."
        )
