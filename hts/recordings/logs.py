"""For those who write a log reader: from columns of a file, and a mapping, to a recording.

    class Reader(LogReader):
        def read(self, files, mapping, robot):
            return recording_from_columns(files, mapping, robot, columns_of)

`columns_of(file)` gives all columns of one file by name; everything that docs/recordings.md says of mappings then
holds: units, signs, joint order, gaps, resampling, limits, idle levels. A format that is no table is put together from
the parts: `samples_of` and `common_grid` and `resampled` for times, `check_limits`, `check_still_joints`,
`check_no_reading`, `check_motion`, `check_idle`, `check_read`, `check_upright`, `check_turning`, `check_told_turn`,
`check_targets`, `torque_notes`, `work_notes`, `velocity_notes`, `foot_notes`, `still_notes`, `axes_notes`,
`repeated_notes`, `temperature_notes` and `exchanged_notes` for values.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hts import units
from hts.channels import Channel
from hts.config import Command, ScheduleConfig
from hts.contracts import Robot
from hts.errors import ConfigError, HtsError, PluginError, RecordingError
from hts.recordings.attitude import still_notes
from hts.recordings.axes import axes_notes
from hts.recordings.base_speed import velocity_notes
from hts.recordings.blank import without_blanks
from hts.recordings.commanded import until_the_end
from hts.recordings.exchanged import exchanged_notes
from hts.recordings.factors import as_one, common_factor, common_offset, of_joints
from hts.recordings.feet import foot_notes
from hts.recordings.gravity import check_upright
from hts.recordings.joining import joined
from hts.recordings.joint_work import work_notes
from hts.recordings.look_over import looked_over
from hts.recordings.mapping import (
    SECONDS,
    ChannelMapping,
    LogMapping,
    Mapped,
    check_held,
    check_joint_order,
    column_names,
    parse_mapping,
    remedy,
)
from hts.recordings.motion import check_motion
from hts.recordings.no_reading import check_no_reading
from hts.recordings.on_schedule import NOT_STATED
from hts.recordings.only import closed_up
from hts.recordings.outliers import outlier_limits, without_outliers
from hts.recordings.pd_torque import torque_notes
from hts.recordings.plausible import check_idle, check_limits
from hts.recordings.recording import Recording, Series
from hts.recordings.repeated import repeated_notes
from hts.recordings.samples import Samples, common_grid, held, interpolated, listed, resampled, samples_of
from hts.recordings.sources import Source, Tables, assign, check_clocks, read_tables, received_apart, source_of
from hts.recordings.stated_channels import check_channels
from hts.recordings.still_joints import check_still_joints
from hts.recordings.stretches import Stretch, stretches
from hts.recordings.table import ColumnName, Table, cannot_be_read, table_of
from hts.recordings.targets import check_targets
from hts.recordings.temperatures import temperature_notes
from hts.recordings.told_turn import check_told_turn
from hts.recordings.turning import check_turning
from hts.recordings.unread import check_read

__all__ = [
    "LogMapping",
    "Samples",
    "Table",
    "axes_notes",
    "check_idle",
    "check_limits",
    "check_motion",
    "check_no_reading",
    "check_read",
    "check_still_joints",
    "check_targets",
    "check_told_turn",
    "check_turning",
    "check_upright",
    "common_grid",
    "exchanged_notes",
    "foot_notes",
    "held",
    "recording_from_columns",
    "recording_from_tables",
    "recordings_from_columns",
    "recordings_from_tables",
    "repeated_notes",
    "resampled",
    "samples_of",
    "still_notes",
    "table_of",
    "temperature_notes",
    "torque_notes",
    "velocity_notes",
    "work_notes",
]

Columns = Mapping[str, Any]
"""Name -> (rows,) numbers, None or NaN where the log has none."""


def recording_from_columns(
    files: Sequence[Path], mapping: Mapping[str, Any], robot: Robot, columns_of: Callable[[Path], Columns]
) -> Recording:
    """One recording from tables that `columns_of` reads: a file -> all its columns by name, each (rows,) numbers.

    Files, mapping and robot are those that a log reader gets. What `columns_of` raises (no such file, no such format)
    becomes a RecordingError that names the file. Raises ConfigError for a wrong mapping, RecordingError naming file,
    column and what to do for a wrong log.
    """
    return recording_from_tables(files, parse_mapping(mapping), robot, _reading(columns_of))


def recordings_from_columns(
    files: Sequence[Path], mapping: Mapping[str, Any], robot: Robot, columns_of: Callable[[Path], Columns]
) -> list[Recording]:
    """The same where a mapping tells several runs in one file apart: one recording each, for a reader's `read_all`."""
    return recordings_from_tables(files, parse_mapping(mapping), robot, _reading(columns_of))


def recording_from_tables(
    files: Sequence[Path], log: Mapped, robot: Robot, read: Callable[[Path, Sequence[ColumnName], Mapped], Table]
) -> Recording:
    """The same from tables of which only the wanted columns are read: read(file, wanted, mapping) -> Table.

    log: the mapping, parsed: a LogMapping or what the reader derives from it.
    """
    recordings = recordings_from_tables(files, log, robot, read)
    if len(recordings) != 1:
        where = ", ".join(str(path) for path in files)
        raise RecordingError(
            f"{where}: {len(recordings)} runs, where one recording is read. Take one by `runs` or `labels`; a reader "
            "of several has a `read_all` with recordings_from_columns."
        )
    return recordings[0]


def recordings_from_tables(
    files: Sequence[Path], log: Mapped, robot: Robot, read: Callable[[Path, Sequence[ColumnName], Mapped], Table]
) -> list[Recording]:
    """One recording for each run that the mapping's `runs` or `labels` tell apart; one where it has neither."""
    check_joint_order(log, robot.spec.joint_names)
    check_held(log, robot)
    check_channels(log, robot)
    columns = {name: column_names(name, one, log, robot.spec.joint_names) for name, one in log.channels.items()}
    assigned = assign(files, log)
    try:
        tables = read_tables(assigned, log, columns, read)
    except RecordingError as error:
        if told := _about_joints(str(error), log, columns, robot):
            raise ConfigError(f"{told} {error}") from error
        raise
    clocks = check_clocks(tables, log)
    notes = {"clocks": f"taken as one: {clocks}"} if clocks else {}
    if apart := received_apart(tables):
        notes["received"] = apart
    tables, blank = without_blanks(tables, log, columns)
    if blank:
        notes["blank_rows_dropped"] = f"{blank} in which all joints are 0"
    times = _times(tables, log)
    if log.join is not None:
        times, offset = joined(times, tables, log, columns)
        notes = {**notes, "clocks": f"the clock of '{log.join.file}' moved by {offset}"}
    parts = [closed_up(one, log) for one in stretches(tables, times, log, assigned)]
    return [_one(files, part, log, columns, robot, {**notes, **part.notes}) for part in parts]


def _one(
    files: Sequence[Path],
    part: Stretch,
    log: LogMapping,
    columns: Mapping[str, tuple[ColumnName, ...]],
    robot: Robot,
    notes: Mapping[str, str],
) -> Recording:
    tables = part.tables
    times = part.times if part.times is not None else _times(tables, log)
    samples, dropped = {}, {}
    for name, one in log.channels.items():
        source = source_of(one)
        table, when = tables[source], times[source]
        values = np.stack([table.columns[column] for column in columns[name]], axis=1)
        values = of_joints(values, one, robot.spec.joint_names)
        values = as_one(values, one)
        kept = _within(when, log, table)
        limits = outlier_limits(name, one, robot)
        values, dropped[name] = without_outliers(name, values[kept], one, limits, table.path)
        names = [f"column {column}" if isinstance(column, int) else column for column in columns[name]]
        found = samples_of(name, when[kept], values, str(table.path), listed(names), names)
        samples[name] = held(found, log.max_gap_seconds, one.max_age_seconds) if one.resample == "hold" else found
    where = ", ".join(str(path) for path in files)
    gauges, own_rate = samples.keys() - robot.channels().keys(), robot.spec.control_rate_hz
    grid = common_grid(samples, log.rate_hz, log.max_gap_seconds, gauges=gauges, control_rate_hz=own_rate)
    channels = {name: _series(one, log, robot, grid) for name, one in samples.items()}
    told = _notes(files, tables, samples, grid, log, dropped)
    recording = _recording(channels, grid, log, robot, {**told, **notes}, where)
    slow = {name: (1 / one.rate_hz, one.oldest) for name, one in samples.items() if one.oldest is not None}
    return looked_over(recording, robot, log, where, slow)


def _about_joints(
    fault: str, log: LogMapping, columns: Mapping[str, tuple[ColumnName, ...]], robot: Robot
) -> str | None:
    """What to write where the fault is a column that the log, which names joints otherwise than the robot, has not."""
    for name, one in log.channels.items():
        by_robot = not log.joints and "{joint}" in str(one.columns)
        if by_robot and any(f"No column named '{column}'." in fault for column in columns[name]):
            listed = ", ".join(f"{joint}: …" for joint in robot.spec.joint_names)
            return (
                f"Mapping: '{name}' uses {{joint}}; give `joints`: the robot's joint -> its name in the log, joints: "
                f"{{{listed}}}. Without it the robot's own names are taken."
            )
    return None


def _times(tables: Tables, log: LogMapping) -> dict[Source, np.ndarray]:
    """Times of each table's rows, s after the first stamp of all; stamps of today in ns are too long for a float."""
    scale = SECONDS[log.time.unit]
    if log.join is not None:
        return {source: (table.stamps - table.stamps[0]) * scale for source, table in tables.items()}
    origin = min(table.stamps[0] for table in tables.values())
    return {source: (table.stamps - origin) * scale for source, table in tables.items()}


def _within(times: np.ndarray, log: LogMapping, table: Table) -> np.ndarray:
    """Rows (rows,) bool of the stretch that the mapping takes."""
    if log.cut is None:
        return np.ones(len(times), dtype=np.bool_)
    kept = (times >= log.cut[0]) & (times <= log.cut[1])
    if kept.sum() < 2:
        raise RecordingError(
            f"{table.path}: nothing is left between {log.cut[0]:g} and {log.cut[1]:g} s after the first stamp; it "
            f"lasts {times[-1]:.4g} s. Correct `cut`, or the unit of the stamps."
        )
    return kept


def _series(samples: Samples, log: LogMapping, robot: Robot, grid: np.ndarray) -> Series:
    one = log.channels[samples.name]
    values = resampled(samples, grid, log.rate_hz, one.resample)
    channel = _channel(samples.name, one, samples.values.shape[1], robot)
    values = common_factor(one) * values + common_offset(one)
    scale, offset = units.conversion(one.unit, channel.unit)
    if (scale, offset) != (1.0, 0.0):
        values = scale * values + offset
    return Series(channel, values.reshape(len(grid), *channel.shape))


def _channel(name: str, one: ChannelMapping, components: int, robot: Robot) -> Channel:
    """The robot's own channel if it has one of that name, else a new one. Raises ConfigError if they disagree."""
    own = robot.channels().get(name)
    if own is None:
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
    files: Sequence[Path],
    tables: Tables,
    samples: Mapping[str, Samples],
    grid: np.ndarray,
    log: LogMapping,
    dropped: Mapping[str, int],
) -> dict[str, str]:
    """What was done to the log on the way in."""
    names = [os.fsencode(path.name).decode("utf-8", "backslashreplace") for path in files]  # a name may be no text
    notes = {"source": ", ".join(names)}
    if log.cut is not None:
        notes["cut"] = f"{log.cut[0]:g} to {log.cut[1]:g} s"
    empty = sum(table.empty_rows for table in tables.values())
    if empty:
        notes["empty_rows_dropped"] = str(empty)
    for key, gone in (("last_line_dropped", True), ("last_line_kept", False)):
        ends = [table for table in tables.values() if table.last_line and table.last_line_dropped == gone]
        if ends:
            named = len(tables) > 1
            notes[key] = ", ".join(f"{one.path.name}: {one.last_line}" if named else one.last_line for one in ends)
    drawn = {name: one for name, one in samples.items() if one.oldest is None}
    inside = {name: int(((one.left_out > grid[0]) & (one.left_out < grid[-1])).sum()) for name, one in drawn.items()}
    counts = {
        "rows_outside_limits_dropped": dropped,
        "incomplete_rows_filled": {name: count - dropped[name] for name, count in inside.items()},
        "samples_interpolated_in_gaps": {name: interpolated(one, grid, log.rate_hz) for name, one in drawn.items()},
    }
    for key, found in counts.items():
        if told := ", ".join(f"{name} {count}" for name, count in found.items() if count > 0):
            notes[key] = told
    stand = [f"{n} from {one.rate_hz:.4g} Hz, for up to {one.oldest:.3g} s" for n, one in samples.items() if one.oldest]
    if stand:
        notes["readings_held"] = "; ".join(stand)
    if grid[0] > 0:
        notes["starts_after_first_stamp"] = f"{grid[0]:.6f} s"
    last = {name: max([one.times[-1], *one.left_out]) for name, one in samples.items()}
    lost = max(last.values()) - grid[-1]
    if lost > 1.0 / log.rate_hz:
        first = min(samples, key=lambda name: samples[name].end)
        notes["ends_before_last_stamp"] = f"{lost:.6f} s ('{first}' ends first)"
    return notes


def _recording(
    channels: dict[str, Series], grid: np.ndarray, log: LogMapping, robot: Robot, notes: dict[str, str], where: str
) -> Recording:
    facts, spec, seconds = log.recording, robot.spec, len(grid) / log.rate_hz
    notes = {**facts.notes, **notes}
    if facts.schedule is None:
        schedule = ScheduleConfig(commands=(Command(seconds=seconds, vx=0.0),))
        notes["schedule"] = NOT_STATED
    else:
        schedule = until_the_end(facts.schedule, seconds, where)
    idle = {}
    for name, one in log.channels.items():
        if one.idle is not None:
            scale, offset = units.conversion(one.unit, channels[name].channel.unit)
            idle[name] = scale * one.idle + offset
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
        idle=idle,
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


def _reading(columns_of: Callable[[Path], Columns]) -> Callable[[Path, Sequence[ColumnName], LogMapping], Table]:
    """How a table is read where somebody's function gives all columns of a file."""

    def read(path: Path, wanted: Sequence[ColumnName], log: LogMapping) -> Table:
        try:
            columns = columns_of(path)
        except HtsError:
            raise
        except OSError as error:
            raise cannot_be_read(path, error) from error
        except (ValueError, LookupError, TypeError, EOFError) as error:
            what = " ".join(f"{type(error).__name__}: {error}".split())
            raise RecordingError(
                f"{path}: not a log that the reader '{log.reader}' knows ({what:.160}). {remedy(log)}"
            ) from error
        if columns is None or isinstance(columns, Sequence):
            raise PluginError(
                f"{path}: log reader '{log.reader}' gives its columns as a {type(columns).__name__}, expected a "
                "mapping from each column's name to its numbers, such as {'t': [0.0, 0.02]}."
            )
        run = log.runs.column if log.runs is not None else None
        return table_of(path, log.time.column, log.time.unit, wanted, columns, run)

    return read
