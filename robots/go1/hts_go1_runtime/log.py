"""The log of a row, as CSV that `hts import` takes, and the mapping that says what its columns are.

Rows go to a thread of their own, so no disk makes a step late. They are on their way to the disk within half a second
and synced once a second: a process that is killed leaves what was flushed, under `.NAME.csv.partial`. The file gets
its name once it is whole. If the disk refuses (full), rows wait in memory and are tried again; `fault` says so.
"""

from __future__ import annotations

import contextlib
import itertools
import json
import os
import queue
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hts_go1_runtime.link import Command, State
from hts_go1_runtime.machine import JOINTS

SYNC_SECONDS, TRY_AGAIN_SECONDS = 1.0, 0.5
SIM = {  # channel -> (unit, numbers a sample); as `hts` names them
    "joint_position": ("rad", 12),
    "joint_velocity": ("rad/s", 12),
    "joint_torque": ("N*m", 12),
    "joint_target": ("rad", 12),
    "angular_velocity": ("rad/s", 3),
    "projected_gravity": ("1", 3),
    "base_velocity": ("m/s", 3),
    "command": ("1", 3),
    "foot_force": ("N", 4),
}
REAL = {"battery_current": ("A", 0), "battery_voltage": ("V", 0)}  # need an idle level
BESIDE = {"state_of_charge": ("%", 0), "motor_temperature": ("degC", 12)}  # neither learned nor learned from
NOTED = ("state_stamp", "state_age_ms", "late_ms", "step_ms", "packets_lost", "packets_late", "phase")
CHANNELS = SIM | REAL | BESIDE


def columns_of(channel: str) -> list[str]:
    """Names of a channel's columns."""
    if channel.startswith("joint_"):
        return [f"{joint}_{channel.removeprefix('joint_')}" for joint in JOINTS]
    size = CHANNELS[channel][1]
    return [f"{channel}_{number}" for number in range(size)] if size else [channel]


def measured(states: Sequence[State]) -> list[str]:
    """Channels that the robot gives, judged by its first states: one that holds numbers in none of them is not
    measured. A single state would not do, since a sensor's first readings may be missing."""
    return [name for name in CHANNELS if any(holds(state, name) for state in states)]


def holds(state: State, channel: str) -> bool:
    """Whether a state has numbers of a channel; 0 degC of all motors are none, see `meeting`."""
    if channel not in _MAY_BE_MISSING:
        return True
    values = _MAY_BE_MISSING[channel](state)
    return bool(np.isfinite(values).all()) and (channel != "motor_temperature" or bool(values.any()))


_MAY_BE_MISSING: Mapping[str, Callable[[State], Any]] = {
    "base_velocity": lambda state: state.velocity,
    "foot_force": lambda state: state.foot_force,
    "battery_current": lambda state: state.current,
    "battery_voltage": lambda state: state.voltage,
    "state_of_charge": lambda state: state.charge,
    "motor_temperature": lambda state: state.temperature,
}


def samples(state: State, sent: np.ndarray, command: Command) -> dict[str, Any]:
    """All channels of a step. sent: the command vx, vy, yaw rate as the policy got it."""
    return {
        "joint_position": state.q,
        "joint_velocity": state.dq,
        "joint_torque": state.tau,
        "joint_target": command.q,
        "angular_velocity": state.gyro,
        "projected_gravity": state.gravity,
        "base_velocity": state.velocity,
        "command": sent,
        "foot_force": state.foot_force,
        "battery_current": state.current,
        "battery_voltage": state.voltage,
        "state_of_charge": state.charge,
        "motor_temperature": state.temperature,
    }


def mapping(
    channels: Sequence[str],
    idle: Mapping[str, float],
    rate_hz: float,
    facts: Mapping[str, Any],
    frozen_real_seconds: float | None = None,
    only: Mapping[str, Any] | None = None,
) -> str:
    """The mapping of a log, as JSON, which is YAML. facts: of `recording`; frozen_real_seconds: for how long what is
    measured may repeat itself in it, s, 0: for ever; None: as whoever reads it says; only: which rows count, None: all.
    """
    described: dict[str, Any] = {}
    for name in channels:
        unit, size = CHANNELS[name]
        columns: Any = f"{{joint}}_{name.removeprefix('joint_')}" if name.startswith("joint_") else columns_of(name)
        one: dict[str, Any] = {"columns": columns if name.startswith("joint_") or size else name, "unit": unit}
        if name in REAL and name in idle:
            one |= {"sign": 1, "idle": round(idle[name], 4)}
        elif name in BESIDE or name in REAL:
            one |= {"real": False, "may_be_constant": name in BESIDE}
        described[name] = one
    content = {
        "reader": "csv",
        "time": {"column": "time", "unit": "s"},
        "rate_hz": rate_hz,
        "joints": {joint: joint for joint in JOINTS},
        "channels": described,
        "recording": dict(facts),
        **({} if frozen_real_seconds is None else {"frozen_real_seconds": frozen_real_seconds}),
        **({} if only is None else {"only": dict(only)}),
    }
    return json.dumps(content, indent=1) + "\n"


class RowLog:
    """Writes one row's log into a folder. channels: which; described: its mapping. `write` once a step, then `closing`.
    A log that is there already keeps its name and its content; `unnamed` then says where this one is.

    All that touches the disk is done by a thread: the mapping, so that what a killed process or a full disk leaves of
    the rows can be read too, then the rows, then the file gets its name.
    """

    def __init__(self, folder: Path, name: str, channels: Sequence[str], described: str = "") -> None:
        self._stem, self.elsewhere = name, ""  # elsewhere: the file that was written in place of a refused one
        self._target, self._partial = folder / f"{name}.csv", folder / f".{name}.csv.partial"
        self._mapping, self._described = folder / "mappings" / f"{name}.yaml", described
        self._channels, self.rows, self.fault = list(channels), 0, ""
        self.unnamed = ""  # why a whole log on the disk did not get its name
        self._waiting = b""
        self._other: Path | None = None
        columns = ["time", *(column for name in channels for column in columns_of(name)), *NOTED]
        # Stamps to the microsecond; values to seven digits, what a float32 holds.
        self._format = (
            ",".join(["%.6f"] + ["%.7g"] * (len(columns) - 1 - len(NOTED)) + ["%.6f"] + ["%.6g"] * (len(NOTED) - 1))
            + "\n"
        )
        self._queue: queue.SimpleQueue[list[float] | str | None] = queue.SimpleQueue()
        self._header = ",".join(columns) + "\n"
        self._queue.put(self._header)
        self._done = threading.Event()
        self._closed = False
        threading.Thread(target=self._work, daemon=True).start()

    def write(self, clock: float, values: Mapping[str, Any], noted: Sequence[float]) -> None:
        """One step. clock: s; noted: see `NOTED`."""
        row = [clock]
        for name in self._channels:
            value = values[name]
            row.extend(value.tolist() if isinstance(value, np.ndarray) else (float(value),))
        self._queue.put([*row, *noted])
        self.rows += 1

    def closing(self, whole: bool = True, described: str = "") -> threading.Event:
        """No more rows come: set once all is on the disk, and the file has its name if it is whole. A disk that refuses
        is tried until then; `fault` says so meanwhile. described: a mapping that takes the place of the first."""
        if not self._closed:
            self._closed, self._whole, self._at_last = True, whole, described
            self._queue.put(None)
        return self._done

    def write_elsewhere(self, folder: Path) -> None:
        """Should the disk still refuse: all of it into this folder instead, with its mapping, where `elsewhere` says.
        After `closing`."""
        self._other = folder

    def _work(self) -> None:
        """The writing thread."""
        handle, synced, over = -1, time.monotonic(), False
        while True:
            time.sleep(0.0 if over else 0.1)
            while not self._queue.empty():
                item = self._queue.get()
                if item is None:
                    over = True
                else:
                    self._waiting += (item if isinstance(item, str) else self._format % tuple(item)).encode()
            try:
                if handle < 0:
                    handle = self._open()
                self._pour(handle)
                if over or time.monotonic() - synced > SYNC_SECONDS:
                    os.fsync(handle)
                    synced = time.monotonic()
                if over:
                    self._name()
                self.fault = ""
            except OSError as error:
                self.fault = f"{error.filename or self._partial}: cannot be written ({error.strerror})"
                if not (over and self._other is not None and self._rescued(handle, self._other)):
                    time.sleep(TRY_AGAIN_SECONDS)
                    continue
            if over:
                break
        if handle >= 0:
            os.close(handle)
        self._done.set()

    def _rescued(self, handle: int, folder: Path) -> bool:
        """Write what is on the disk and what waits into another folder; False if that does not work either."""
        try:
            written = os.pread(handle, os.fstat(handle).st_size, 0) if handle >= 0 else b""
        except OSError:  # what is in memory at least
            written = b"" if self._waiting.startswith(self._header.encode()) else self._header.encode()
        file = folder / (f"{self._stem}.csv" if self._whole else f"{self._stem}.csv.partial")
        try:
            write_whole(file, (written + self._waiting).decode())
            write_whole(folder / "mappings" / f"{self._stem}.yaml", self._at_last or self._described)
        except OSError as error:
            self.fault = f"{error.filename or file}: cannot be written ({error.strerror})"
            return False
        self.elsewhere = str(file)
        return True

    def _pour(self, handle: int) -> None:
        """What waits, onto the disk, in whole lines: a disk that fills up within one gets none of that one."""
        lines, left = self._waiting, self._waiting
        try:
            while left:
                left = left[os.write(handle, left) :]
            self._waiting = b""
        except OSError:
            done = len(lines) - len(left)
            whole = lines.rfind(b"\n", 0, done) + 1
            end = os.lseek(handle, 0, os.SEEK_CUR) - (done - whole)
            os.ftruncate(handle, end)
            os.lseek(handle, end, os.SEEK_SET)
            self._waiting = lines[whole:]
            raise

    def _open(self) -> int:
        """The partial file, new; one that an earlier visit left is kept under another name."""
        self._partial.parent.mkdir(parents=True, exist_ok=True)
        if self._described:
            write_whole(self._mapping, self._described)
        if self._partial.exists():
            names = (self._partial.with_name(f"{self._partial.name}-{number}") for number in itertools.count())
            self._partial.replace(next(name for name in names if not name.exists()))  # one may have been taken away
        return os.open(self._partial, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o644)

    def _name(self) -> None:
        """The mapping is there already, so whoever sees the log sees what it is."""
        if not self._whole:
            return
        if self._target.exists():
            self.unnamed = f"{self._target}: came from elsewhere meanwhile; what was recorded is in {self._partial}"
            return
        if self._at_last:
            write_whole(self._mapping, self._at_last)
        self._partial.replace(self._target)
        with contextlib.suppress(OSError):  # the log is there, whole, and its name; some file systems cannot do this
            folder = os.open(self._target.parent, os.O_RDONLY)
            try:
                os.fsync(folder)
            finally:
                os.close(folder)


def write_whole(path: Path, text: str) -> None:
    """A small file in one move. Raises OSError."""
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.name}.tmp")
    with temporary.open("w", encoding="utf-8") as file:
        file.write(text)
        file.flush()
        os.fsync(file.fileno())
    temporary.replace(path)
