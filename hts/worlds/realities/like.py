"""What a lab's own recordings say of its robot: figures that draws are held against instead of the public facts.

    idle          the idle levels that somebody read off
    standing      stretches at the command 0 in which no joint moves
    walking       straight stretches of the policy to start from, one figure per asked speed
    tolerance     t_{n-1} s √(1 + 1/n) + δ |m| around the mean m of n stretches with standard deviation s: where the
                  next stretch of that robot lies in 95 of 100 cases, and a share δ for what no twin has; at most MOST

A draw is recorded as the robot was: recordings of head-to-heads (role `reference`) are of a warm robot that walks at
one speed; where there are none, those of a collection, which begin with cold motors, are repeated schedule and all.

The next stretch and not the mean: a draw is held against them in a session of its own, as warm and as charged as it
happens to be. δ is a model's discrepancy in the sense of Kennedy and O'Hagan 2001: what figures of one robot differ by
between days (charge, temperature, floor) though a single store's do not show it, and what of its structure no twin has.
DISCREPANCY is an estimate; MOST is what public figures are trusted to (± 25 %).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from pydantic import Field

from hts.config import Config, ScheduleConfig
from hts.contracts import Fact, Instrument, Reading
from hts.errors import RecordingError
from hts.quantiles import student_quantile
from hts.recordings.on_schedule import samples_at
from hts.recordings.recording import Recording
from hts.worlds.realities.read_off import read_off

if TYPE_CHECKING:
    from hts.plugins import Registry

SETTLING = 3.0  # s at the beginning of a stretch that are not read: gauge lag and getting going
SHORTEST = 2.0  # s of a stretch that is left to read
STILL = 0.5  # rad/s, root mean square over all joints: a robot that stands does not step
DISCREPANCY, MOST = 0.05, 0.25  # of the mean
LEVEL = 0.95
RUNS_STORE = "data.zarr"  # in a run's folder
WALKED = Reading(
    "speed", "m/s", ("base_velocity",), lambda channels, idle: float(channels["base_velocity"][:, 0].mean())
)
"""What no instrument shows: how fast the robot goes for a command."""


class Figure(Config):
    """One figure of a robot, and how far a draw may be from it."""

    name: str = Field(description="for tables")
    instrument: str = Field(description='whose reading it is; "": the robot\'s own speed')
    reading: str = Field(description="name of the reading")
    speed: float = Field(description="command sent, m/s; 0: standing, or idle")
    asked: float = Field(description="speed that the schedule asked for, m/s")
    value: float = Field(description="mean over stretches, in `unit`")
    low: float = Field(description="lowest value that agrees")
    high: float = Field(description="highest value that agrees")
    unit: str = Field(description="of all three")
    stretches: int = Field(ge=1, description="that it was read from")
    idle: bool = Field(False, description="whether the idle levels alone say it")


class Likeness(Config):
    """What a draw is held against instead of the public facts, and how it is recorded for that."""

    figures: tuple[Figure, ...] = Field(description="of the lab's robot")
    schedule: ScheduleConfig | None = Field(
        description="walked from cold, as the recordings were; null: warm, at each figure's speed by itself"
    )


@dataclass(frozen=True)
class Stretch:
    """A part of a recording at one command. asked: of the schedule; sent: mean of the channel `command`; both m/s."""

    recording: Recording
    asked: float
    sent: float
    rows: slice


def likeness(
    recordings: Sequence[Recording],
    robot: str,
    policy_hash: str,
    instruments: Mapping[str, Instrument],
    discrepancy: float = DISCREPANCY,
) -> Likeness:
    """What recordings of the robot say: idle, standing, and walking with the policy of that hash. discrepancy: δ.

    Raises RecordingError if none of them can say anything of a walk.
    """
    own = [one for one in recordings if one.robot == robot and not one.fell]
    if not own:
        kinds = ", ".join(sorted({one.robot for one in recordings})) or "none at all"
        raise RecordingError(f"No recording of robot '{robot}' that did not fall; found: {kinds}.")
    walkers = [one for one in own if one.policy_hash in (policy_hash, "")]
    warm = [one for one in walkers if one.role == "reference"]  # of head-to-heads, which warm up first
    schedule = None if warm else _usual_schedule(walkers)
    stretches = list(_stretches(warm or [one for one in walkers if one.schedule == schedule]))
    asked = sorted({one.asked for one in stretches if one.asked > 0})
    if not asked:
        known = ", ".join(sorted({one.policy_hash[:12] for one in own}))
        raise RecordingError(
            f"No straight stretch of at least {SETTLING + SHORTEST:g} s that the policy {policy_hash[:12]} walked; "
            f"found recordings of {known}. Record it at one speed or several, or name the policy that was recorded: "
            "--policy."
        )
    standing = [one for recording in own for one in _stretches([recording]) if one.asked == 0 and _still(one)]
    found = [*_idle(own, instruments, discrepancy), *_of(standing, "standing", (0.0, 0.0), instruments, discrepancy)]
    for speed in asked:
        group = [one for one in stretches if one.asked == speed]
        sent = round(float(np.mean([one.sent for one in group])), 3)
        found += _of(group, f"at {sent:g} m/s", (sent, speed), {**instruments, "": None}, discrepancy)
    return Likeness(figures=tuple(found), schedule=schedule)


def _usual_schedule(recordings: Sequence[Recording]) -> ScheduleConfig | None:
    """The one that most of them walked; those that nobody can read a stretch of do not count."""
    able = [one.schedule for one in recordings if any(stretch.asked > 0 for stretch in _stretches([one]))]
    return max(able, key=able.count) if able else None


def _stretches(recordings: Sequence[Recording]) -> Iterator[Stretch]:
    """Straight stretches, without their beginnings; standing ones too."""
    for recording in recordings:
        schedule = recording.schedule.commands
        ends = np.cumsum([command.seconds for command in schedule])
        first = samples_at(recording, np.concatenate([[0.0], ends[:-1]]) + SETTLING)
        stop = samples_at(recording, ends)
        for command, begin, end in zip(schedule, first.tolist(), stop.tolist(), strict=True):
            rows = slice(begin, end)
            straight = command.is_velocity and command.vy == 0 and command.yaw_rate == 0 and command.vx >= 0
            if not straight or end - begin < SHORTEST * recording.rate_hz:
                continue
            sent = command.vx
            if "command" in recording.channels and command.vx > 0:
                sent = float(recording.values("command")[rows, 0].mean())
            yield Stretch(recording, command.vx, sent, rows)


def _still(stretch: Stretch) -> bool:
    recording = stretch.recording
    if "joint_velocity" not in recording.channels:
        return False
    return float(np.sqrt(np.square(recording.values("joint_velocity")[stretch.rows]).mean())) < STILL


def _idle(
    recordings: Sequence[Recording], instruments: Mapping[str, Instrument], discrepancy: float
) -> Iterator[Figure]:
    """One figure per idle reading, over the recordings' different levels."""
    for name, reading in _readings(instruments):
        if reading.idle:
            there = [one for one in recordings if all(channel in one.idle for channel in reading.channels)]
            values = sorted({read_off(reading, {}, one.idle) for one in there})
            if values:
                yield _figure(reading.name, name, reading, (0.0, 0.0), values, discrepancy)


def _of(
    stretches: Sequence[Stretch],
    where: str,
    speeds: tuple[float, float],
    instruments: Mapping[str, Instrument | None],
    discrepancy: float,
) -> Iterator[Figure]:
    """One figure per reading of these stretches, where they hold its channels. speeds: sent and asked."""
    for name, reading in _readings(instruments):
        values = [] if reading.idle else _values(name, reading, stretches)
        if values:
            yield _figure(f"{reading.name} {where}", name, reading, speeds, values, discrepancy)


def _values(instrument: str, reading: Reading, stretches: Sequence[Stretch]) -> list[float]:
    """Of each stretch that holds what is needed; an instrument's channels have idle levels."""
    needed, values = set(reading.channels), []
    for one in stretches:
        if needed <= set(one.recording.channels) and (not instrument or needed <= set(one.recording.idle)):
            rows = {name: one.recording.values(name)[one.rows] for name in needed}
            values.append(read_off(reading, rows, one.recording.idle))
    return values


def _readings(instruments: Mapping[str, Instrument | None]) -> Iterator[tuple[str, Reading]]:
    for name, instrument in instruments.items():
        for reading in (WALKED,) if instrument is None else instrument.readings():
            yield name, reading


def _figure(
    title: str,
    instrument: str,
    reading: Reading,
    speeds: tuple[float, float],
    values: Sequence[float],
    discrepancy: float,
) -> Figure:
    mean, width = float(np.mean(values)), tolerance(values, discrepancy)
    if not math.isfinite(mean):
        raise RecordingError(f"{title}: is not a number in these recordings; look at {', '.join(reading.channels)}.")
    return Figure(
        name=title,
        instrument=instrument,
        reading=reading.name,
        speed=speeds[0],
        asked=speeds[1],
        value=round(mean, 4),
        low=round(mean - width, 4),
        high=round(mean + width, 4),
        unit=reading.unit,
        stretches=len(values),
        idle=reading.idle,
    )


def tolerance(values: Sequence[float], discrepancy: float = DISCREPANCY) -> float:
    """How far a twin's value may lie from the mean of these; of a single value no scatter is known."""
    mean, count, scatter = abs(float(np.mean(values))), len(values), 0.0
    if count > 1:
        scatter = float(
            student_quantile((1 + LEVEL) / 2, count - 1) * np.std(values, ddof=1) * math.sqrt(1 + 1 / count)
        )
    return min(scatter + discrepancy * mean, max(MOST, discrepancy) * mean)


# --------------------------------------------------------------------------------------------- of a draw


def facts_of(figures: Sequence[Figure], instruments: Mapping[str, Instrument]) -> list[Fact]:
    """The figures as facts that a draw is held against. Those of instruments that are not there are left out."""
    known = {(name, one.name): one for name, one in _readings({**instruments, "": None})}
    return [
        Fact(one.name, one.speed, one.low, one.high, one.unit, "recordings", known[one.instrument, one.reading].reading)
        for one in figures
        if (one.instrument, one.reading) in known and not one.idle
    ]


def shown_by(
    recordings: Sequence[Recording], figures: Sequence[Figure], instruments: Mapping[str, Instrument]
) -> dict[str, float]:
    """What recordings of a draw, made as the lab's were, show of the figures of walking: name -> value."""
    known = {(name, one.name): one for name, one in _readings({**instruments, "": None})}
    stretches, found = list(_stretches(recordings)), {}
    for one in figures:
        reading = known.get((one.instrument, one.reading))
        if reading is None or reading.idle or one.asked == 0:
            continue
        values = _values(one.instrument, reading, [stretch for stretch in stretches if stretch.asked == one.asked])
        if values:
            found[one.name] = float(np.mean(values))
    return found


def shown_idle(figures: Sequence[Figure], instruments: Mapping[str, Instrument]) -> dict[str, float]:
    """What a draw shows of the figures that its idle levels alone say, name -> value: before anything is simulated."""
    levels: dict[str, float] = {}
    for instrument in instruments.values():
        instrument.reset(1, np.random.default_rng(0))
        levels |= instrument.idle()
    known = {(name, one.name): one for name, one in _readings(instruments)}
    return {
        one.name: read_off(known[one.instrument, one.reading], {}, levels)
        for one in figures
        if one.idle and (one.instrument, one.reading) in known
    }


def recorded(
    recordings: Sequence[Recording],
    robot: str,
    policy_hash: str,
    registry: Registry,
    discrepancy: float = DISCREPANCY,
) -> Likeness:
    """`likeness` with the installed instruments of this robot. Raises RecordingError if they show nothing of it but its
    speed."""
    machine = registry.make_robot(robot)
    instruments = {name: registry.make_instrument(name, {}, machine) for name in sorted(registry.instruments)}
    found = likeness(recordings, robot, policy_hash, instruments, discrepancy)
    if not any(one.instrument for one in found.figures):
        needed = sorted({channel for _, one in _readings(instruments) for channel in one.channels})
        raise RecordingError(
            "These recordings hold nothing that an installed instrument shows, so no draw can be told from another. "
            f"They need one of: {', '.join(needed) or 'no instrument gives readings'}, each with its idle level."
        )
    return found


def of_store(store: Path, robot: str, policy: Path, registry: Registry, discrepancy: float = DISCREPANCY) -> Likeness:
    """`recorded` of a store, or of a run's own. policy: exported."""
    from hts.policies.deploy import DeployedPolicy
    from hts.recordings.store import RecordingStore

    source = RecordingStore(store / RUNS_STORE if (store / RUNS_STORE).is_dir() else store)
    recordings = [source.read(one) for one in source.ids()]
    return recorded(recordings, robot, DeployedPolicy(policy).card.policy_hash, registry, discrepancy)


def table(figures: Sequence[Figure]) -> str:
    """What was used, in markdown."""
    rows = ["| figure | value | agrees from | to | stretches |", "|---|---|---|---|---|"]
    for one in figures:
        rows.append(f"| {one.name} | {one.value:.4g} {one.unit} | {one.low:.4g} | {one.high:.4g} | {one.stretches} |")
    return "\n".join(rows)
