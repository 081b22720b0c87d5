"""One rollout of one policy under one schedule on one world: its time series and all that is needed to use them."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

import numpy as np

from hts.channels import Channel
from hts.config import ScheduleConfig
from hts.errors import RecordingError, unknown_name

ROLES = ("collection", "policy", "reference")


@dataclass(frozen=True, eq=False)
class Series:
    """A channel and its samples, float32 (T, *channel.shape). Raises RecordingError if they are not numbers."""

    channel: Channel
    values: np.ndarray

    def __post_init__(self) -> None:
        try:
            # A number beyond float32 becomes inf here, which the store refuses by name.
            with np.errstate(over="ignore"):
                values = np.asarray(self.values, dtype=np.float32)
        except (TypeError, ValueError) as error:
            raise RecordingError(
                f"Channel '{self.channel.name}' does not hold an array of numbers ({error})."
            ) from error
        object.__setattr__(self, "values", values)


@dataclass(frozen=True, eq=False)
class Recording:
    """One rollout. Tuples of length J follow `joint_names`; T is the number of samples.

    robot, world: as registered; policy_hash: of the exported policy that ran ("" if unknown);
    iteration: round of Algorithm 1 that made it (0: before the first fine-tuning);
    kp N*m/rad, kd N*m*s/rad; rate_hz: of every channel; schedule: the commanded velocities;
    idle: real channel -> its level with electronics on and motors idle, in the channel's unit; these keys say
    which channels are real, and so may be learned from; clock: what `time` counts ("simulated", "monotonic", ...);
    time: s, shape (T,), increasing; channels: by name, each (T, *shape); mass_kg: of the robot as it walked;
    session: one head-to-head is one session; block: position in the session; role: one of ROLES;
    fell: whether the robot fell; notes: anything else worth keeping; id: given by the store, "" before.
    """

    robot: str
    world: str
    policy_hash: str
    iteration: int
    joint_names: tuple[str, ...]
    kp: tuple[float, ...]
    kd: tuple[float, ...]
    rate_hz: float
    schedule: ScheduleConfig
    idle: Mapping[str, float]
    clock: str
    time: np.ndarray
    channels: Mapping[str, Series]
    mass_kg: float | None = None
    session: str = ""
    block: int = 0
    role: str = "collection"
    fell: bool = False
    notes: Mapping[str, str] = field(default_factory=dict)
    id: str = ""

    def __post_init__(self) -> None:
        try:
            time = np.asarray(self.time, dtype=np.float64)
        except (TypeError, ValueError) as error:
            raise RecordingError(f"The time of a recording is not an array of seconds ({error}).") from error
        object.__setattr__(self, "time", time)

    @property
    def num_samples(self) -> int:
        return int(self.time.shape[0])

    @property
    def seconds(self) -> float:
        """Length, counting the last sample's own period."""
        return self.num_samples / self.rate_hz

    @property
    def robot_samples(self) -> int:
        """Control steps of the robot: the recorded ones, and those before them that its note `unrecorded_seconds`
        tells of (warming up, trimming). Raises RecordingError if that note is no duration."""
        return self.num_samples + round(noted_seconds(self, "unrecorded_seconds", 0.0) * self.rate_hz)

    def values(self, channel: str) -> np.ndarray:
        """Samples of one channel, float32 (T, *shape). Raises RecordingError for a channel that is not there."""
        if channel not in self.channels:
            name = self.id or "this recording"
            raise RecordingError(f"{name}: " + unknown_name("channel", channel, self.channels))
        return self.channels[channel].values

    def replace(self, **changes: object) -> Recording:
        """A copy with some fields changed. The id is dropped, because it names the content."""
        return dataclasses.replace(self, **{"id": "", **changes})  # type: ignore[arg-type]


def robot_samples_of(recordings: Iterable[Recording]) -> int:
    """Real samples: what recordings cost of the robot's time, trimming and warming up included, in control steps."""
    return sum(recording.robot_samples for recording in recordings)


def noted_seconds(recording: Recording, note: str, otherwise: float) -> float:
    """A duration, s, that a recording's notes state; `otherwise` where they do not.

    Raises RecordingError, which names the note, for what is no number, below 0, or more than can be counted in samples:
    fewer than no samples would lengthen what the robot may still walk.
    """
    noted = recording.notes.get(note)
    if noted is None:
        return otherwise
    try:
        seconds = float(noted)
    except (TypeError, ValueError):
        seconds = math.nan
    if not (seconds >= 0.0 and math.isfinite(seconds * recording.rate_hz)):
        whose = f"{recording.id}: its" if recording.id else "A recording's"
        raise RecordingError(f"{whose} note {note} is '{noted}', expected a number of seconds from 0 on.")
    return seconds
