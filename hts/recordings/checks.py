"""What a store refuses. A bad number stops here, before it can become a good reward."""

from __future__ import annotations

import math

import numpy as np

from hts import units
from hts.errors import RecordingError, unknown_name
from hts.recordings.gravity import check_gravity
from hts.recordings.recording import ROLES, Recording, Series

# The mean rate of the time stamps may differ from the stated rate by this much before it is taken for a mistake.
RATE_TOLERANCE = 0.05


def check(recording: Recording, where: str = "Recording") -> None:
    """Raise RecordingError unless the recording is fit to be stored.

    where: how the message begins, such as the log's path.
    """
    _check_header(recording, where)
    _check_time(recording, where)
    if not recording.channels:
        raise RecordingError(f"{where}: no channels. Expected at least one; record or map some.")
    for name, series in recording.channels.items():
        _check_series(name, series, recording, where)
    check_gravity(recording.channels, where)
    for name in recording.idle:
        if name not in recording.channels:
            raise RecordingError(
                f"{where}: an idle level is given, but: " + unknown_name("channel", name, recording.channels)
            )
        channel = recording.channels[name].channel
        if not channel.may_be_constant and not recording.fell:  # a quick fall is over before a slow gauge moves
            check_moves(name, channel.unit, recording.channels[name].values, where)


def check_moves(name: str, unit: str, values: np.ndarray, where: str) -> None:
    """Refuse a real channel that stands still. values: (T, ...). A sensor that is not read repeats its last value."""
    flat = values.reshape(len(values), -1)
    for column in range(flat.shape[1]):
        if len(flat) > 1 and np.all(flat[:, column] == flat[0, column]):
            part = f"'{name}'" if flat.shape[1] == 1 else f"'{name}' column {column}"
            raise RecordingError(
                f"{where}: {part} is {flat[0, column]:g} {unit} in all {len(flat)} samples. The sensor was probably "
                "not being read. See that it is, and record again (of a run on a robot, the same row). A log that is "
                f"imported may go without: hts import --drop {name}."
            )


def _check_header(recording: Recording, where: str) -> None:
    if not recording.robot or not recording.world:
        raise RecordingError(
            f"{where}: robot and world must be named, found '{recording.robot}' and '{recording.world}'."
        )
    if recording.role not in ROLES:
        raise RecordingError(f"{where}: " + unknown_name("role", recording.role, ROLES))
    joints = len(recording.joint_names)
    gains = {"kp": recording.kp, "kd": recording.kd}
    for gain, values in gains.items():
        if len(values) != joints:
            raise RecordingError(
                f"{where}: {gain} has {len(values)} values for {joints} joints. Give one per joint, in joint order."
            )
    numbers = {"rate_hz": recording.rate_hz, **{f"idle level of '{k}'": v for k, v in recording.idle.items()}}
    if recording.mass_kg is not None:
        numbers["mass_kg"] = recording.mass_kg
    for gain, values in gains.items():
        numbers.update({f"{gain} of {j}": v for j, v in zip(recording.joint_names, values, strict=True)})
    for name, number in numbers.items():
        if not math.isfinite(number):
            raise RecordingError(f"{where}: {name} is {number}. Expected a finite number; measure or state it.")
    if recording.rate_hz <= 0:
        raise RecordingError(f"{where}: rate_hz is {recording.rate_hz:g}. Expected samples per second, above 0.")


def _check_time(recording: Recording, where: str) -> None:
    time = recording.time
    if time.ndim != 1 or len(time) < 2:
        raise RecordingError(f"{where}: time has shape {time.shape}. Expected (T,) with at least 2 samples.")
    _check_finite("time", time, where)
    steps = np.diff(time)
    if not np.all(steps > 0):
        at = int(np.argmax(steps <= 0))
        raise RecordingError(
            f"{where}: time does not increase at sample {at + 1}: {time[at]:.6f} s, then {time[at + 1]:.6f} s. "
            "Sort or repair the log's time stamps."
        )
    rate = (len(time) - 1) / (time[-1] - time[0])
    if abs(rate / recording.rate_hz - 1.0) > RATE_TOLERANCE:
        raise RecordingError(
            f"{where}: the time stamps make {rate:.4g} Hz, but rate_hz says {recording.rate_hz:g}. "
            "State the rate that was recorded, or resample."
        )


def _check_series(name: str, series: Series, recording: Recording, where: str) -> None:
    channel, values = series.channel, series.values
    if name != channel.name or not name.isidentifier() or name == "time":
        raise RecordingError(
            f"{where}: channel '{channel.name}' is listed as '{name}'. "
            "Expected one name of letters, digits and _, other than 'time'."
        )
    if not units.known(channel.unit):
        raise RecordingError(f"{where}: channel '{name}': {units.unknown(channel.unit)}")
    if values.shape[1:] != tuple(channel.shape) or values.ndim == 0:
        raise RecordingError(
            f"{where}: '{name}' has shape {values.shape}. Expected (T, *{tuple(channel.shape)}), T samples first. "
            "Check the columns and their order."
        )
    if len(values) != recording.num_samples:
        raise RecordingError(
            f"{where}: '{name}' has {len(values)} samples, time has {recording.num_samples}. "
            "All channels need one length; resample or cut them."
        )
    _check_finite(name, values, where)


def _check_finite(name: str, values: np.ndarray, where: str) -> None:
    bad = ~np.isfinite(values)
    if bad.any():
        rows = np.flatnonzero(bad.reshape(len(values), -1).any(axis=1))
        raise RecordingError(
            f"{where}: '{name}' is NaN or infinite in {len(rows)} of {len(values)} samples, first at sample {rows[0]}. "
            "Of an imported log, fill or cut the gaps, or leave the channel out: hts import --drop "
            f"{name}. Of a simulated robot, mend what gives it: an instrument, or the simulation."
        )
