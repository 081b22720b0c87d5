"""The mapping of a log: which column is which channel, in what unit, sign and joint order. Written as YAML.

time: {column: stamp, unit: ns}
rate_hz: 50
joints: {left_hip: LH, left_knee: LK}            # robot's joint: the log's name for it
channels:
  joint_torque: {columns: "{joint}_tau", unit: N*m}
  joint_velocity: {columns: "{joint}_dq", unit: rad/s}
  supply: {columns: amps, unit: A, sign: -1, idle: 1.9}
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, TypeVar

from pydantic import Field, ValidationError, field_validator, model_validator

from hts import units
from hts.config import Config, ScheduleConfig
from hts.config_base import MayBeEndless
from hts.contracts import Robot
from hts.errors import ConfigError, unknown_name
from hts.explain import explain
from hts.recordings.commanded import without_end
from hts.recordings.mapping_parts import JoinMapping, LabelsMapping, OnlyMapping, RunsMapping
from hts.recordings.table import DATES, ColumnName
from hts.recordings.unread import LONGEST_SECONDS
from hts.yaml_text import load_mapping_file

SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, DATES: 1e-9}
"""Unit of stamps -> s; dates are read as whole nanoseconds."""


class TimeMapping(Config):
    """Where the time stamps are."""

    column: ColumnName = Field(description="name, or number from 0 where the file has no header line")
    unit: Literal["s", "ms", "us", "ns", "iso"] = Field(description="unit of the stamps; iso: dates and times")


class ChannelMapping(Config):
    """One channel from one or more columns: value = sign * scale * column + offset."""

    columns: ColumnName | tuple[ColumnName, ...] = Field(
        description="a column; a list of them; a range of numbers '13..24' or of entries 'q[0..11]'; or a pattern "
        "with {joint}"
    )
    unit: str = Field(
        description="of the value after sign, scale and offset, see hts.units; converted to that of the robot's channel"
    )
    file: str | None = Field(None, description="which of `files` the columns are in")
    topic: str | None = Field(None, description="of a file of messages: the topic, where it is not the mapping's own")
    sum: bool = Field(False, description="the channel is the sum of the columns, empty where one of them is")
    max: bool = Field(False, description="the channel is the largest of the columns, after sign and scale; likewise")
    sign: Literal[1, -1] | dict[str, Literal[1, -1]] = Field(
        1, description="-1 where the log counts the other way; {joint: -1} of some joints, by the robot's names"
    )
    scale: float | dict[str, float] = Field(1.0, description="factor to the unit above; {joint: factor} likewise")
    offset: float | dict[str, float] = Field(0.0, description="added after the factor, in the unit above; likewise")
    resample: Literal["interpolate", "mean", "hold"] = Field(
        "interpolate",
        description="value at each sample's instant; mean over one sample period around it; or, of what only the "
        "robot measures, hold: the last reading at or before it",
    )
    max_age_seconds: float | None = Field(
        None,
        gt=0,
        description="of resample: hold, how old a reading may become, s; left out: three median times between "
        "readings, at most 3 s, or max_gap_seconds if that is longer",
    )
    per_joint: bool | None = Field(None, description="columns follow the joints; default: the name begins with joint_")
    idle: float | None = Field(None, description="level with electronics on and motors idle; makes it a real channel")
    real: bool = Field(True, description="false: a channel that the robot does not list, yet not one to learn")
    limits: tuple[MayBeEndless, MayBeEndless] | None = Field(
        None, description="in the unit above, outside of which nothing may lie"
    )
    outside: Literal["refuse", "drop"] = Field(
        "refuse",
        description="the log whose values lie outside the limits, or drop such rows, at most 1 in 100; without "
        "`limits` what no machine like the robot can do, 20 times its own limits",
    )
    may_be_constant: bool = Field(False, description="for a quantity that may honestly stand still")
    description: str = Field("", description="for the reader of the store")

    @field_validator("unit")
    @classmethod
    def _known_unit(cls, unit: str) -> str:
        if not units.known(unit):
            raise ValueError(units.unknown(unit))
        return unit


class RecordingFacts(Config):
    """What the log cannot say of itself."""

    world: str = Field("field", min_length=1, description="where it was recorded")
    clock: str = Field("log", description="what the stamps count")
    policy_hash: str = Field("", description="of the exported policy that ran")
    iteration: int = Field(0, ge=0, description="round of the run it belongs to")
    schedule: ScheduleConfig | None = Field(
        None,
        description="commanded velocities, as long as the log; the last may leave out `seconds` and lasts until the "
        "log ends. Left out: one stretch at 0 m/s",
    )
    mass_kg: float | None = Field(None, gt=0, description="of the robot as it walked, kg")
    session: str = Field("", description="head-to-head it belongs to")
    block: int = Field(0, ge=0, description="position in the session")
    role: Literal["collection", "policy", "reference"] = Field(
        "collection", description="first data, or a block of the policy or of its reference in a head-to-head"
    )
    fell: bool = Field(False, description="whether the robot fell")
    kp: tuple[float, ...] | None = Field(None, description="gains, N*m/rad; left out: the robot's own")
    kd: tuple[float, ...] | None = Field(None, description="gains, N*m*s/rad; left out: the robot's own")
    notes: dict[str, str] = Field(default_factory=dict, description="anything else worth keeping")

    @field_validator("schedule", mode="before")
    @classmethod
    def _may_have_no_end(cls, schedule: Any) -> Any:
        return without_end(schedule)


class LogMapping(Config):
    """A whole mapping. A reader of tables that needs to be told more derives from it."""

    reader: str = Field("csv", description="log reader, by name")
    files: dict[str, str] | None = Field(
        None, description="name -> pattern of the file name, where one recording is spread over several files"
    )
    time: TimeMapping = Field(description="the column of time stamps")
    rate_hz: float = Field(gt=0, description="of the recording, Hz; the log is resampled to it")
    max_gap_seconds: float = Field(
        0.1, allow_inf_nan=True, gt=0, description="longest gap that is filled by interpolation, s"
    )
    frozen_real_seconds: float = Field(
        LONGEST_SECONDS,
        ge=0,
        le=600,
        description="for how long what only the robot measures may keep one number while joints move, s; 0: for ever",
    )
    runs: RunsMapping | None = Field(None, description="how several runs in one file are told apart")
    labels: LabelsMapping | None = Field(None, description="a file of labelled stretches")
    only: OnlyMapping | None = Field(None, description="rows that are no part of the run, such as turns at a wall")
    join: JoinMapping | None = Field(None, description="how the clocks of two files are brought together")
    one_clock: bool = Field(False, description="the stamps of all files count one clock, although each begins at 0")
    cut: tuple[MayBeEndless, MayBeEndless] | None = Field(
        None, description="take only this stretch, s after the first stamp"
    )
    joints: dict[str, str] | None = Field(
        None, description="robot's joint -> its name in the log, for {joint}; left out: the robot's own names"
    )
    joint_order: tuple[str, ...] | None = Field(
        None, description="robot's joint names in the order of the log's columns; left out: the robot's order"
    )
    channels: dict[str, ChannelMapping] = Field(min_length=1, description="by channel name")
    recording: RecordingFacts = Field(default_factory=RecordingFacts, description="what the log cannot say of itself")

    @model_validator(mode="after")
    def _cut_and_limits_are_whole(self) -> LogMapping:
        if self.cut is not None and not self.cut[0] < self.cut[1]:
            raise ValueError(f"cut is {list(self.cut)}; its end must come after its beginning")
        for name, channel in self.channels.items():
            if channel.columns == ():
                raise ValueError(f"channel '{name}': columns are none; name one at least")
            if (channel.sum or channel.max) and follows_joints(name, channel):
                what = "sum" if channel.sum else "max"
                raise ValueError(f"channel '{name}' follows the joints, so it is no `{what}`; say per_joint: false")
            if channel.limits is not None and not channel.limits[0] < channel.limits[1]:
                raise ValueError(f"channel '{name}': limits are {list(channel.limits)}; the lower one comes first")
        return self

    @model_validator(mode="after")
    def _only_has_one_clock(self) -> LogMapping:
        beside = [key for key in ("runs", "labels", "cut") if vars(self)[key] is not None]
        if self.only is not None and beside:
            raise ValueError(
                f"`only` closes the log's clock up, so it does not go with `{beside[0]}`; cut the log into files of "
                "one run each"
            )
        return self

    @model_validator(mode="after")
    def _ages_are_of_held_ones(self) -> LogMapping:
        for name, channel in self.channels.items():
            if channel.max_age_seconds is not None and channel.resample != "hold":
                raise ValueError(
                    f"channel '{name}': max_age_seconds goes with resample: hold, this one is resampled by "
                    f"{channel.resample}; say hold, or leave it out"
                )
        return self

    @model_validator(mode="after")
    def _files_are_known(self) -> LogMapping:
        for name, channel in self.channels.items():
            if (channel.file is None) != (self.files is None):
                raise ValueError(f"channel '{name}': `file` goes with `files`; give both or neither")
            if channel.file is not None and self.files is not None and channel.file not in self.files:
                raise ValueError(f"channel '{name}': " + unknown_name("file", channel.file, self.files))
        for key, one in (("labels", self.labels), ("join", self.join)):
            if one is not None and one.file not in (self.files or ()):
                raise ValueError(f"{key}: " + unknown_name("file", one.file, self.files or ()))
        if self.only is not None and (self.only.file is None) != (self.files is None):
            raise ValueError("only: `file` goes with `files`; give both or neither")
        if self.only is not None and self.only.file is not None and self.only.file not in (self.files or ()):
            raise ValueError("only: " + unknown_name("file", self.only.file, self.files or ()))
        if self.runs is not None and self.files is not None:
            raise ValueError("`runs` are told apart within one file; it does not go with `files`")
        return self

    @model_validator(mode="after")
    def _join_names_channels(self) -> LogMapping:
        if self.join is None:
            return self
        for name in (self.join.channel, self.join.match):
            if name not in self.channels:
                raise ValueError("join: " + unknown_name("channel", name, self.channels))
        if self.channels[self.join.channel].file != self.join.file:
            raise ValueError(f"join: channel '{self.join.channel}' is not in the file '{self.join.file}'")
        if self.channels[self.join.match].file == self.join.file:
            raise ValueError(f"join: '{self.join.match}' is in '{self.join.file}', too; name a channel of another file")
        return self


MOST_COLUMNS = 1000
"""Of one channel."""

Mapped = TypeVar("Mapped", bound=LogMapping)


def remedy(mapping: LogMapping) -> str:
    """What to do with a file that its reader does not know: where nobody named a reader, another may."""
    named = "reader" in mapping.model_fields_set
    return "Repair the file." if named else "Repair the file, or name its reader in the mapping."


def load_mapping(path: Path) -> dict[str, Any]:
    """The YAML of a mapping, not yet validated. Raises ConfigError if it cannot be read."""
    mapping = load_mapping_file(path, "mapping of the log")
    if not mapping:
        raise ConfigError(f"{path}: expected keys and values (time, rate_hz, channels), found nothing.")
    return mapping


def parse_mapping(mapping: Mapping[str, Any], kind: type[Mapped] = LogMapping) -> Mapped:  # type: ignore[assignment]
    """A validated mapping. Raises ConfigError with the key and the closest right one."""
    try:
        return kind.model_validate(dict(mapping))
    except ValidationError as error:
        raise ConfigError(f"Mapping: {explain(error, kind)}") from error


def follows_joints(name: str, channel: ChannelMapping) -> bool:
    """Whether the channel has one component per joint."""
    return name.startswith("joint_") if channel.per_joint is None else channel.per_joint


def column_names(
    name: str, channel: ChannelMapping, mapping: LogMapping, joint_names: tuple[str, ...]
) -> tuple[ColumnName, ...]:
    """Columns of a channel, one per component; those that follow the joints come in the robot's order.

    Raises ConfigError where the mapping does not say enough, or one column twice.
    """
    columns = channel.columns
    per_joint = follows_joints(name, channel)
    if isinstance(columns, str) and "{joint}" in columns:
        joints = mapping.joints or {joint: joint for joint in joint_names}
        _same_joints("joints", joints, joint_names)
        _once("joints", [joints[joint] for joint in joint_names], "joint")
        return tuple(columns.replace("{joint}", joints[joint]) for joint in joint_names)
    if isinstance(columns, str) and ".." in columns:
        listed = _range(name, columns)
    else:
        listed = columns if isinstance(columns, tuple) else (columns,)
        if per_joint or channel.sum or channel.max or len(set(listed)) == 1:  # one of zeros may fill up a command
            _once(f"columns of '{name}'", listed, "component")
    if per_joint and len(listed) != len(joint_names):
        raise ConfigError(
            f"Mapping: '{name}' has {len(listed)} columns for {len(joint_names)} joints. "
            f"List one per joint{_entries(listed, len(joint_names))}, or say per_joint: false."
        )
    if per_joint and mapping.joint_order is not None:
        _same_joints("joint_order", mapping.joint_order, joint_names)
        return tuple(listed[mapping.joint_order.index(joint)] for joint in joint_names)
    return listed


def _entries(listed: Sequence[ColumnName], joints: int) -> str:
    """How a single column that holds lists is written."""
    if len(listed) != 1 or not isinstance(listed[0], str):
        return ""
    whole = listed[0].partition("[")[0]
    return f", '{whole}[0..{joints - 1}]' where the column '{whole}' holds lists"


def assumed_order(mapping: Mapping[str, Any], joint_names: Sequence[str]) -> str | None:
    """A note where columns are listed or numbered per joint and nobody said in which order; None elsewhere.

    mapping: as it was written, of a log that could be read with it.
    """
    if mapping.get("joint_order") is not None or len(joint_names) < 2 or not ordered(mapping):
        return None
    return f"no joint_order: columns taken in the robot's, {', '.join(joint_names)}"


def ordered(mapping: Mapping[str, Any]) -> list[str]:
    """Channels whose columns are listed or numbered per joint, so that `joint_order` matters to them.

    mapping: as it was written.
    """
    channels = mapping.get("channels")
    found = []
    for name, one in channels.items() if isinstance(channels, Mapping) else ():
        given = one if isinstance(one, Mapping) else {}
        per_joint = given.get("per_joint")
        follows = str(name).startswith("joint_") if per_joint is None else per_joint
        if follows and "{joint}" not in str(given.get("columns", "{joint}")):
            found.append(str(name))
    return found


def check_joint_order(mapping: LogMapping, joint_names: tuple[str, ...]) -> None:
    """Raise ConfigError for a `joint_order` that is not of the robot's joints, or that no channel follows."""
    if mapping.joint_order is None:
        return
    _same_joints("joint_order", mapping.joint_order, joint_names)
    if not ordered(mapping.model_dump()):
        raise ConfigError(
            "Mapping: joint_order has no effect: no channel's columns are listed or numbered per joint; those with "
            "{joint} are found by the names in `joints`. Leave joint_order out, or list the columns in that order (and "
            "say per_joint: true of channels whose name does not begin with joint_)."
        )


def check_held(mapping: LogMapping, robot: Robot) -> None:
    """Raise ConfigError for `resample: hold` of a channel that the robot has in simulation too."""
    for name, channel in mapping.channels.items():
        if channel.resample == "hold" and name in robot.channels():
            raise ConfigError(
                f"Mapping: channels.{name}.resample is hold, but robot '{robot.spec.name}' has '{name}' in simulation "
                "too, where it changes with every step: a model would learn from stairs that it never meets there. Say "
                "interpolate or mean, and log it at rate_hz or faster."
            )


def _range(name: str, columns: str) -> tuple[ColumnName, ...]:
    """The columns that '13..24' or 'q[0..11]' stands for."""
    pattern = r"(?:(?P<list>.+)\[)?(?P<first>\d{1,6})\.\.(?P<last>\d{1,6})(?(list)\](?P<rest>(?:\..+)?))"
    found = re.fullmatch(pattern, columns)
    numbers = range(int(found["first"]), int(found["last"]) + 1) if found else range(0)
    if found is None or not 0 < len(numbers) <= MOST_COLUMNS:
        raise ConfigError(
            f"Mapping: columns '{columns:.80}' of '{name}' are no range of numbers such as '13..24' or 'q[0..11]'."
        )
    if not found["list"]:
        return tuple(numbers)
    return tuple(f"{found['list']}[{number}]{found['rest']}" for number in numbers)


def _once(key: str, given: Sequence[ColumnName], what: str) -> None:
    """Raise ConfigError where one thing of the log stands for two: a copied line would be data that nobody measured."""
    twice = [one for one in dict.fromkeys(given) if given.count(one) > 1]
    if twice:
        where = ", ".join(str(number) for number, one in enumerate(given, 1) if one == twice[0])
        raise ConfigError(
            f"Mapping: {key}: '{twice[0]}' is named {given.count(twice[0])} times (entries {where}). "
            f"Name another column of the log for each {what}."
        )


def _same_joints(key: str, given: Any, joint_names: tuple[str, ...]) -> None:
    for joint in given:
        if joint not in joint_names:
            raise ConfigError(f"Mapping: {key}: " + unknown_name("joint", joint, joint_names))
    missing = [joint for joint in joint_names if joint not in given]
    if missing or len(given) != len(joint_names):
        what = f"{', '.join(missing)} missing" if missing else "a joint is named twice"
        raise ConfigError(f"Mapping: {key}: {what}. Name each of the robot's {len(joint_names)} joints once.")
