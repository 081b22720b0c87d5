"""Comma-separated logs, read by a mapping (mapping.py) into a recording."""

from __future__ import annotations

import fnmatch
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hts import units
from hts.channels import Channel
from hts.config import Command, Config, ScheduleConfig
from hts.contracts import LogReader, Robot
from hts.errors import ConfigError, RecordingError
from hts.recordings.checks import check
from hts.recordings.csv_table import Table, read_table
from hts.recordings.mapping import (
    SECONDS,
    ChannelMapping,
    ColumnName,
    LogMapping,
    column_names,
    follows_joints,
    parse_mapping,
)
from hts.recordings.plausible import implausible, outside
from hts.recordings.recording import Recording, Series
from hts.recordings.resample import interpolate, window_mean

if TYPE_CHECKING:
    from hts.contracts import Settings


class CsvSettings(Config):
    """The reader has no settings; everything is in the mapping."""


def make(settings: Settings) -> LogReader:
    """Factory of the log reader `csv`."""
    CsvSettings.model_validate(dict(settings))
    return CsvReader()


class CsvReader(LogReader):
    """Columns to channels, resampled to one even rate, short gaps filled, checked against the robot."""

    def read(self, files: Sequence[Path], mapping: Mapping[str, Any], robot: Robot) -> Recording:
        """One recording from one file, or from several that the mapping's `files` tells apart.

        Raises ConfigError for a wrong mapping, RecordingError naming file, column and what to do for a wrong log.
        """
        log = parse_mapping(mapping)
        columns = {name: column_names(name, one, log, robot.spec.joint_names) for name, one in log.channels.items()}
        tables = _read_tables(_assign(files, log), log, columns)
        origin = min(table.stamps[0] for table in tables.values())
        scale = SECONDS[log.time.unit]
        sources = {
            name: _Source(tables[one.file], columns[name], (tables[one.file].stamps - origin) * scale, name)
            for name, one in log.channels.items()
        }
        where = ", ".join(str(path) for path in files)
        grid = _grid(sources, log, where)
        channels = {}
        for name, source in sources.items():
            channels[name] = _series(name, source, log, robot, grid)
        recording = _recording(channels, grid, log, robot, _notes(files, tables, sources, grid))
        _check_plausible(recording, log, robot, where)
        check(recording, where)
        return recording


class _Source:
    """The rows of one channel that hold numbers: times (rows,) s and values (rows, k), as in the log."""

    def __init__(self, table: Table, columns: tuple[ColumnName, ...], times: np.ndarray, name: str) -> None:
        values = np.stack([table.columns[column] for column in columns], axis=1)
        there = np.isfinite(values).all(axis=1)
        if there.sum() < 2:
            raise RecordingError(
                f"{table.path}: columns of '{name}' ({_listed(columns)}) hold no numbers. "
                f"Correct the mapping, or import without it: --drop {name}"
            )
        self.table, self.column_names = table, columns
        self.times, self.values = times[there], values[there]
        self.missing = int((~there).sum())


def _assign(files: Sequence[Path], log: LogMapping) -> dict[str | None, Path]:
    """Which file is which of the mapping's `files`; {None: the file} where the mapping has none."""
    if log.files is None:
        if len(files) != 1:
            raise ConfigError(
                f"Mapping: {len(files)} files for one recording; name them under `files`, or import one by one."
            )
        return {None: files[0]}
    assigned: dict[str | None, Path] = {}
    for name, pattern in log.files.items():
        matching = [path for path in files if fnmatch.fnmatch(path.name, pattern)]
        if len(matching) != 1:
            given = ", ".join(path.name for path in files)
            raise ConfigError(
                f"Mapping: files.{name}: pattern '{pattern}' fits {len(matching)} of the files ({given}), not one."
            )
        assigned[name] = matching[0]
    unused = [str(path) for path in files if path not in assigned.values()]
    if unused:
        raise ConfigError(f"Mapping: no pattern under `files` fits {', '.join(unused)}. Add one or leave the file out.")
    return assigned


def _read_tables(
    assigned: Mapping[str | None, Path], log: LogMapping, columns: Mapping[str, tuple[ColumnName, ...]]
) -> dict[str | None, Table]:
    tables = {}
    for key, path in assigned.items():
        wanted = {column: None for name, one in log.channels.items() if one.file == key for column in columns[name]}
        if wanted:
            tables[key] = read_table(path, log.time.column, tuple(wanted), log.header, log.delimiter)
    return tables


def _grid(sources: Mapping[str, _Source], log: LogMapping, where: str) -> np.ndarray:
    """Even sample times, s, over the stretch where every channel has data. Refuses long gaps and slow logs."""
    start = max(source.times[0] for source in sources.values())
    end = min(source.times[-1] for source in sources.values())
    for name, source in sources.items():
        path, times = source.table.path, source.times
        steps = np.diff(times)
        widths = np.where((times[1:] > start) & (times[:-1] < end), steps, 0.0)
        longest = int(np.argmax(widths))
        rate = 1.0 / float(np.median(steps))
        if rate < 0.9 * log.rate_hz:
            raise RecordingError(
                f"{path}: '{name}' was logged at {rate:.4g} Hz, the mapping wants {log.rate_hz:g}. "
                f"Set rate_hz to {rate:.4g} or less; samples cannot be invented."
            )
        if widths[longest] > log.max_gap_seconds:
            raise RecordingError(
                f"{path}: '{name}' ({_listed(source.column_names)}) has nothing for {widths[longest]:.3g} s, "
                f"from {times[longest]:.3f} s on; gaps up to {log.max_gap_seconds:g} s are filled. "
                "Cut the log there, or raise max_gap_seconds if that is harmless."
            )
    samples = int(np.floor((end - start) * log.rate_hz + 1e-6)) + 1 if end > start else 0
    if samples < 2:
        raise RecordingError(f"{where}: the channels share no stretch of time. Check the time column and its unit.")
    return np.minimum(start + np.arange(samples) / log.rate_hz, end)


def _series(name: str, source: _Source, log: LogMapping, robot: Robot, grid: np.ndarray) -> Series:
    one = log.channels[name]
    if one.resample == "mean":
        values = window_mean(source.times, source.values, grid, 1.0 / log.rate_hz)
    else:
        values = interpolate(source.times, source.values, grid)
    channel = _channel(name, one, len(source.column_names), robot)
    values = one.sign * one.scale * values + one.offset
    scale, offset = units.conversion(one.unit, channel.unit)
    if (scale, offset) != (1.0, 0.0):
        values = scale * values + offset
    return Series(channel, values.reshape(len(grid), *channel.shape))


def _channel(name: str, one: ChannelMapping, components: int, robot: Robot) -> Channel:
    """The robot's own channel if it has one of that name, else a new one. Raises ConfigError if they disagree."""
    own = robot.channels().get(name)
    if own is None:
        if one.real and one.idle is None:
            raise ConfigError(
                f"Mapping: '{name}' is no channel of robot '{robot.spec.name}' "
                f"({', '.join(sorted(robot.channels()))}). If only the real robot measures it, give its `idle` level "
                "(electronics on, motors idle); if not, say real: false."
            )
        shape = () if components == 1 else (components,)
        return Channel(name, one.unit, shape, one.description, one.may_be_constant)
    try:
        units.conversion(one.unit, own.unit)
    except RecordingError as error:
        raise ConfigError(
            f"Mapping: '{name}' is in {own.unit} on robot '{robot.spec.name}', not {one.unit}: {error} Correct the "
            "unit, or the column."
        ) from error
    if int(np.prod(own.shape)) != components:
        raise ConfigError(
            f"Mapping: '{name}' has {components} columns, robot '{robot.spec.name}' gives it shape {own.shape}."
        )
    return own


def _notes(
    files: Sequence[Path], tables: Mapping[str | None, Table], sources: Mapping[str, _Source], grid: np.ndarray
) -> dict[str, str]:
    """What was done to the log on the way in."""
    notes = {"source": ", ".join(path.name for path in files)}
    empty = sum(table.empty_rows for table in tables.values())
    if empty:
        notes["empty_rows_dropped"] = str(empty)
    filled = [f"{name} {source.missing}" for name, source in sources.items() if source.missing]
    if filled:
        notes["incomplete_rows_filled"] = ", ".join(filled)
    if grid[0] > 0:
        notes["starts_after_first_stamp"] = f"{grid[0]:.6f} s"
    return notes


def _recording(
    channels: dict[str, Series],
    grid: np.ndarray,
    log: LogMapping,
    robot: Robot,
    notes: dict[str, str],
) -> Recording:
    facts, spec = log.recording, robot.spec
    notes = {**facts.notes, **notes}
    schedule = facts.schedule
    if schedule is None:
        schedule = ScheduleConfig(commands=(Command(seconds=len(grid) / log.rate_hz, vx=0.0),))
        notes["schedule"] = "not stated in the mapping"
    return Recording(
        robot=spec.name,
        world=facts.world,
        policy_hash=facts.policy_hash,
        iteration=facts.iteration,
        joint_names=spec.joint_names,
        kp=facts.kp or spec.kp,
        kd=facts.kd or spec.kd,
        rate_hz=log.rate_hz,
        schedule=schedule,
        idle={name: one.idle for name, one in log.channels.items() if one.idle is not None},
        clock=facts.clock,
        time=np.arange(len(grid)) / log.rate_hz,
        channels=channels,
        mass_kg=facts.mass_kg,
        session=facts.session,
        block=facts.block,
        role=facts.role,
        fell=facts.fell,
        notes=notes,
    )


def _check_plausible(recording: Recording, log: LogMapping, robot: Robot, where: str) -> None:
    """Refuse columns that cannot be what the mapping says; all the evidence in one line."""
    per_joint = {name: follows_joints(name, one) for name, one in log.channels.items()}
    evidence = implausible(recording.channels, per_joint, robot.spec)
    for name, one in log.channels.items():
        if one.limits is not None:
            low, high = one.limits
            scale, offset = units.conversion(one.unit, recording.channels[name].channel.unit)
            evidence += outside(name, recording.channels[name], (scale * low + offset, scale * high + offset))
    if not evidence:
        return
    for name in recording.idle:
        series = recording.channels[name]
        if np.ptp(series.values) == 0 and not series.channel.may_be_constant:
            evidence.append(f"'{name}' is {series.values.flat[0]:g} {series.channel.unit} all the time")
    raise RecordingError(
        f"{where}: the columns are not what the mapping says: {'; '.join(evidence)}. "
        "Look at the columns and correct the mapping; if the log itself is wrong, do not use it."
    )


def _listed(columns: tuple[ColumnName, ...]) -> str:
    text = ", ".join(f"column {column}" if isinstance(column, int) else column for column in columns[:3])
    return text + (", …" if len(columns) > 3 else "")
