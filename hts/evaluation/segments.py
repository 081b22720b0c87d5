"""Segments: the 1 s pieces of recordings that every real-world number is made of.

A piece counts if the task was done in it; for a robot that follows a commanded velocity: if its mean forward speed lies
within ±10 % of the commanded one (the paper's protocol).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from hts.contracts import VELOCITY, Task
from hts.errors import PluginError, RecordingError, unknown_name
from hts.recordings.on_schedule import samples_at
from hts.recordings.recording import noted_seconds
from hts.recordings.repeated import runs_of

if TYPE_CHECKING:
    from hts.recordings.recording import Recording

FALLEN_GRAVITY_Z = -0.5  # projected gravity z of an upright trunk is -1; -0.5 is a tilt of 60 degrees
MISSING = 0.03  # share of a piece's samples, by the recording's own clock; one sample where that is less
SETTLE_SECONDS = 2.0  # of a recording and of every command: walking is not steady yet
SEGMENT_SECONDS = 1.0  # of a piece
BEFORE_FALL_SECONDS = 1.0  # a stumble starts before the trunk has tilted
LYING_SECONDS = 0.5  # who collapses without tilting has lain for so long before a world counts it as a fall
FELL_AT = "fell_at"  # note of a recording: when it was seen to have fallen, s after its first sample, with commas


@dataclass(frozen=True)
class Segments:
    """Valid 1 s pieces of several recordings, S of them, in the order of the recordings and of time.

    samples: n, control steps per piece; recording (S,): index into `recordings`; start (S,): first sample;
    speed, commanded (S,): mean forward speed and commanded one, m/s, or of another task what `Task.achieved` says and
    the set-point, both in its unit; block (S,): numbers each block of each
    session, so that pieces with one number were recorded without interruption;
    total: pieces cut before the validity test; falls: times the trunk tipped over, or as many as a recording's notes
    `falls` or `fell_at` say, at least one per recording that says it fell; walked: mean `speed` of all pieces, near
    falls and gaps left out, whether they count or not; NaN without any; gaps: pieces in which samples are missing.
    """

    recordings: tuple[Recording, ...]
    samples: int
    recording: np.ndarray
    start: np.ndarray
    speed: np.ndarray
    commanded: np.ndarray
    block: np.ndarray
    total: int
    falls: int
    walked: float
    gaps: int = 0

    def __len__(self) -> int:
        return len(self.start)

    @property
    def valid(self) -> float:
        """Share of the pieces that count, 0 to 1; 0 if there are none."""
        return len(self) / self.total if self.total else 0.0

    @property
    def time(self) -> np.ndarray:
        """Start of each piece on its recording's clock, s, shape (S,)."""
        starts = [self.recordings[i].time[s] for i, s in zip(self.recording, self.start, strict=True)]
        return np.array(starts, dtype=float)

    def values(self, channel: str) -> np.ndarray:
        """The channel in each piece, shape (S, n, *shape). Raises RecordingError if a recording lacks it."""
        series = [self._series(recording, channel) for recording in self.recordings]
        pieces = [series[i][s : s + self.samples] for i, s in zip(self.recording, self.start, strict=True)]
        if not pieces:
            shape = series[0].shape[1:] if series else ()
            return np.empty((0, self.samples, *shape))
        return np.stack(pieces)

    def idle(self, channel: str) -> np.ndarray:
        """Idle level of the channel in each piece's recording, shape (S,)."""
        for recording in self.recordings:
            if channel not in recording.idle:
                raise RecordingError(
                    f"A recording of policy {recording.policy_hash[:8]} on world '{recording.world}' has no idle level "
                    f"of '{channel}'. Measure it with electronics on and motors idle and give it with the recording."
                )
        return np.array([self.recordings[i].idle[channel] for i in self.recording], dtype=float)

    @property
    def mass_kg(self) -> np.ndarray:
        """Mass of the robot in each piece's recording, kg, shape (S,)."""
        for recording in self.recordings:
            if recording.mass_kg is None:
                raise RecordingError(
                    f"A recording of policy {recording.policy_hash[:8]} on world '{recording.world}' does not say the "
                    "robot's mass. Weigh it and give mass_kg with the recording."
                )
        return np.array([self.recordings[i].mass_kg for i in self.recording], dtype=float)

    @staticmethod
    def _series(recording: Recording, channel: str) -> np.ndarray:
        if channel not in recording.channels:
            where = f"A recording of policy {recording.policy_hash[:8]} on world '{recording.world}': "
            raise RecordingError(where + unknown_name("channel", channel, recording.channels))
        return np.asarray(recording.channels[channel].values)


def cut(recordings: Sequence[Recording], speed_tolerance: float = 0.1, task: Task = VELOCITY) -> Segments:
    """Cut recordings into pieces of SEGMENT_SECONDS that do not overlap, and keep the valid ones.

    The first SETTLE_SECONDS of a recording and of every command are dropped and not counted (a world that knows
    better says so in the recording's note `unsteady_seconds`). A piece is valid if
    the task was done in it (see `Task.done`), no more than one sample or `MISSING` of them are missing in it, and it is
    not near a fall (from 1 s before the trunk tilts over to SETTLE_SECONDS after it stands again; of one that did not
    tilt it see `_near_falls`).
    Raises RecordingError if rates differ or a channel that the task is judged by is missing.
    """
    rates = sorted({recording.rate_hz for recording in recordings})
    if len(rates) > 1:
        raise RecordingError(
            f"Recordings with rates of {', '.join(f'{rate:g}' for rate in rates)} Hz cannot be cut together: "
            "resample them to one rate when importing."
        )
    samples = round(rates[0] * SEGMENT_SECONDS) if rates else 0
    spare = max(1.5, MISSING * samples)  # clocks jitter
    columns: list[tuple[int, int, float, float, int]] = []
    blocks: dict[tuple[str, int], int] = {}
    walked: list[float] = []
    total = falls = gaps = 0
    for index, recording in enumerate(recordings):
        block = blocks.setdefault((recording.session, recording.block), len(blocks))
        settle = noted_seconds(recording, "unsteady_seconds", SETTLE_SECONDS)
        near_fall, count = _near_falls(recording, settle)
        falls += count
        achieved = _achieved(recording, task)
        step = float(np.median(np.diff(recording.time))) if recording.num_samples > 1 else 1 / recording.rate_hz
        for start, commanded in _starts(recording, settle, samples):
            total += 1
            piece = slice(start, start + samples)
            speed = float(achieved[piece].mean())
            missing = (recording.time[piece][-1] - recording.time[piece][0]) / step - (samples - 1)
            if missing > spare:
                gaps += 1
                continue
            if near_fall[piece].any():
                continue
            walked.append(speed)
            if task.done(speed, commanded, speed_tolerance):
                columns.append((index, start, speed, commanded, block))
    table = np.array(columns, dtype=float).reshape(-1, 5).T
    return Segments(
        recordings=tuple(recordings),
        samples=samples,
        recording=table[0].astype(int),
        start=table[1].astype(int),
        speed=table[2],
        commanded=table[3],
        block=table[4].astype(int),
        total=total,
        falls=falls,
        walked=float(np.mean(walked)) if walked else float("nan"),
        gaps=gaps,
    )


def kept(segments: Segments, which: np.ndarray) -> Segments:
    """Those of the pieces alone, bool (S,); the others are no longer valid."""
    columns = {name: vars(segments)[name][which] for name in ("recording", "start", "speed", "commanded", "block")}
    return replace(segments, **columns)


def falls_of(role: str, recordings: Sequence[Recording]) -> int:
    """How often that role fell in all of them, "policy" or "reference": counted as in `Segments`."""
    return sum(_near_falls(recording, 0.0)[1] for recording in recordings if recording.role == role)


def _achieved(recording: Recording, task: Task) -> np.ndarray:
    """What the task says of each sample, (T,). Raises RecordingError for a missing channel, PluginError if it says
    something else."""
    found = np.asarray(task.achieved({name: Segments._series(recording, name) for name in task.channels}))
    if found.shape != (recording.num_samples,):
        raise PluginError(
            f"{type(task).__name__}.achieved gives shape {found.shape} for {recording.num_samples} samples; expected "
            "one number per sample."
        )
    return found


def _falls_noted(recording: Recording) -> int:
    """A world may see falls that do not tilt the trunk. Raises RecordingError for a note that is no count."""
    noted = recording.notes.get("falls", "0")
    if not (noted.isascii() and noted.isdecimal()):
        raise RecordingError(f"A recording's note falls is '{noted}', expected how often it fell, a whole number.")
    return int(noted)


def _starts(recording: Recording, settle_seconds: float, samples: int) -> list[tuple[int, float]]:
    """First sample and set-point of each piece, in order."""
    merged = _merged(recording)
    ends = np.cumsum([seconds for _, seconds in merged])
    first = samples_at(recording, np.concatenate([[0.0], ends[:-1]]) + settle_seconds)
    stop = samples_at(recording, ends)
    return [
        (start, set_point)
        for (set_point, _), begin, end in zip(merged, first.tolist(), stop.tolist(), strict=True)
        for start in range(begin, end - samples + 1, samples)
    ]


def _merged(recording: Recording) -> list[tuple[float, float]]:
    """(set-point, seconds) of the schedule, equal commands in a row taken as one."""
    merged: list[tuple[tuple[float, float, float], float]] = []
    for command in recording.schedule.commands:
        velocity = (command.commanded, command.vy, command.yaw_rate)
        if merged and merged[-1][0] == velocity:
            merged[-1] = (velocity, merged[-1][1] + command.seconds)
        else:
            merged.append((velocity, command.seconds))
    return [(velocity[0], seconds) for velocity, seconds in merged]


def _near_falls(recording: Recording, settle_seconds: float) -> tuple[np.ndarray, int]:
    """Samples near a fall, bool (T,), and the number of falls.

    A fall that did not tilt the trunk is where the note `fell_at` says. Without that note the recording ended in it if
    it is shorter than its schedule, or if its world notes no `falls` at all, as of a log that stops there; a world
    that counts them sets its robot up again, so that of one of its blocks nothing is known to be sound.
    """
    num, rate = len(recording.time), recording.rate_hz
    near, fallen = np.zeros(num, dtype=bool), np.zeros(num, dtype=bool)
    before, lying, after = (round(s * rate) for s in (BEFORE_FALL_SECONDS, LYING_SECONDS, settle_seconds))
    if "projected_gravity" in recording.channels:
        fallen = np.asarray(recording.channels["projected_gravity"].values)[:, 2] > FALLEN_GRAVITY_Z
    falls = runs_of(fallen)
    for down, up in falls:
        near[max(0, down - before) : up + after] = True
    moments = moments_of_falls(recording)
    for at in samples_at(recording, moments):
        if not fallen[min(at, num - 1)]:
            near[max(0, at - before - lying) : at + 1 + after] = True
    if recording.fell and not falls and not moments:
        ended_in_it = "falls" not in recording.notes or num / rate < recording.schedule.seconds - BEFORE_FALL_SECONDS
        end = max(0, num - round((BEFORE_FALL_SECONDS + settle_seconds) * rate))
        near[end if ended_in_it else 0 :] = True
    return near, max(len(falls), len(moments), int(recording.fell), _falls_noted(recording))


def moments_of_falls(recording: Recording) -> list[float]:
    """When a world saw it fall, s after the first sample. Raises RecordingError for a note that says no such times."""
    noted = recording.notes.get(FELL_AT)
    if noted is None:
        return []
    last = float(recording.time[-1] - recording.time[0])
    try:
        moments = [float(one) for one in noted.split(",")]
    except ValueError:
        moments = [math.nan]
    if not all(0.0 <= one <= last + 0.5 / recording.rate_hz for one in moments):
        raise RecordingError(
            f"A recording's note {FELL_AT} is '{noted}', expected seconds after its first sample, up to {last:g}, as "
            "in 1.5, 4."
        )
    return moments
