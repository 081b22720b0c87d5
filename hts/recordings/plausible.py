"""Whether columns and facts can be what a mapping says they are, judged by the robot's limits and by the idle level.

Logs exist whose header says torque over columns that hold motor temperatures. Units do not show that; limits do.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

import numpy as np

from hts import units
from hts.contracts import Robot, RobotSpec
from hts.contracts.speeds import fastest
from hts.errors import RecordingError
from hts.recordings.recording import Recording, Series
from hts.recordings.robot_model import robot_model
from hts.recordings.standard_units import in_standard_units

# A log may overshoot a limit for a moment (estimates, impacts). It may not do so typically, nor by half in 1 % of it.
PEAK_FACTOR = 1.5
PEAK_SHARE = 0.01
# Encoder zeros and soft stops: a position may lie this far outside its range, rad.
POSITION_MARGIN = 0.35
# Not even a single sample: an impact reads a few times a limit, a broken packet thousands of times.
ABSURD_FACTOR = 20.0
# A robot at work takes several times what it takes idle. A thousandfold is another unit.
IDLE_FACTOR = 100.0
# The zero of degC is arbitrary, so no factor says anything. Motors warm by some tens of degC; K are 273 off.
IDLE_APART = 200.0
# While joints move (rad/s, the fastest of them) in half of a log or more, a machine draws more than idle: not less in
# this share of those samples, and at their median not by a tenth. Standing, or between two days, levels may lie closer.
MOVING_SPEED, MOVING_SHARE = 1.0, 0.5
BELOW_IDLE, LESS_THAN_IDLE = 0.95, 0.9
# Nobody walks with four times its own mass on its back, nor without four fifths of it. Grams are 1000 to 1.
MASS_FACTOR = 5.0


def check_limits(
    channels: Mapping[str, Series],
    spec: RobotSpec,
    where: str,
    *,
    per_joint: Collection[str] | None = None,
    stated: Mapping[str, tuple[float, float]] | None = None,
    real: Collection[str] = (),
) -> None:
    """Raise RecordingError, one line with all the evidence, for channels that cannot be what they are said to be.

    Torques, speeds and positions of joints are held against the limits of `spec`. where: begins the message, such as
    the file; per_joint: names of channels with a component per joint, by default those that begin with joint_;
    stated: name -> (low, high) in the channel's unit, outside of which nothing may lie; real: names of real channels,
    which must not stand still.
    """
    if per_joint is None:
        per_joint = {name for name in channels if name.startswith("joint_")}
    evidence = implausible(channels, {name: name in per_joint for name in channels}, spec)
    for name, limits in (stated or {}).items():
        evidence += outside(name, channels[name], limits)
    if not evidence:
        return
    for name in real:
        series = channels[name]
        if np.ptp(series.values) == 0 and not series.channel.may_be_constant:
            evidence.append(f"'{name}' is {series.values.flat[0]:g} {series.channel.unit} all the time")
    raise RecordingError(
        f"{where}: the columns are not what the mapping says: {'; '.join(evidence)}. "
        "Look at the columns and correct the mapping; if the log itself is wrong, do not use it."
    )


def check_idle(channels: Mapping[str, Series], idle: Mapping[str, float], where: str) -> None:
    """Raise RecordingError for a real channel that its idle level shows to have another sign or unit.

    idle: name -> level with electronics on and motors idle, in the channel's unit; 0 says nothing of a unit. where:
    begins the message. The median is compared: of the other sign it was counted the other way, a hundred times larger
    or smaller it is in another unit. Of a temperature, in degC, the difference says it, and nothing says a sign.
    What is drawn, in A or W, was counted the other way too where both are negative, or where it lies below a level of 0
    nearly always while the joints move, as `joint_velocity` in `channels` shows: a machine that idles draws some, and
    gives none back. Below a level that is not 0 the level is wrong; a voltage may lie there.
    """
    for name, level in idle.items():
        series = channels[name]
        unit, median = series.channel.unit, float(np.median(series.values))
        by_ratio, draws = not units.is_temperature(unit), any(units.one_quantity(unit, drawn) for drawn in ("A", "W"))
        if series.channel.may_be_constant or (level == 0 and by_ratio and not draws):
            continue
        ratio = median / level if by_ratio and level != 0 else 1.0
        hint = ""
        if not by_ratio and abs(median - level) > IDLE_APART:
            hint = "One of them is probably in another unit (K are no degC): correct unit or offset, or the idle level"
        elif draws and level < 0 and median < 0:
            hint = f"Both probably count the other way: say sign: -1 and idle: {-level:g}"
        elif ratio < -1 / IDLE_FACTOR:
            hint = "The log probably counts the other way: say sign: -1"
        elif abs(ratio) > IDLE_FACTOR or abs(ratio) < 1 / IDLE_FACTOR:
            hint = "One of them is probably in another unit (mA are no A): correct unit or scale, or the idle level"
        elif draws and level == 0 and _below_idle(series, level, channels):
            hint = "The log probably counts the other way: say sign: -1"
        elif draws and level > 0 and (below := _below_idle(series, level, channels)):
            hint = (
                f"While the joints move {below:.0%} of its samples lie below that, but a machine that moves draws more "
                "than one that idles: measure the idle level again (electronics on, motors idle; standing is not idle)"
            )
        if hint:
            raise RecordingError(
                f"{where}: '{name}' is {median:.4g} {unit} at the median, its idle level {level:g} {unit}. {hint}; if "
                "it is right, say so with `limits`."
            )


def _below_idle(series: Series, level: float, channels: Mapping[str, Series]) -> float:
    """Share of the samples below the idle level while the joints move, if that cannot be; else 0."""
    speed = channels.get("joint_velocity")
    if speed is None or speed.channel.unit != "rad/s" or series.values.ndim != 1:
        return 0.0
    moving = np.abs(speed.values).reshape(len(speed.values), -1).max(axis=1) > MOVING_SPEED
    if len(moving) != len(series.values) or moving.mean() < MOVING_SHARE:
        return 0.0
    drawn = series.values[moving]
    below = float((drawn < level).mean())
    return below if below >= BELOW_IDLE and np.median(drawn) < LESS_THAN_IDLE * level else 0.0


def check_facts(recording: Recording, robot: Robot, where: str) -> None:
    """Raise RecordingError for a stated mass or commanded velocity that this robot cannot have. where: begins the
    message. A mass is held against the robot's model, if it has one."""
    most = fastest(robot.spec)
    for number, command in enumerate(recording.schedule.commands):
        told = (("vx", "m/s", command.vx), ("vy", "m/s", command.vy), ("yaw_rate", "rad/s", command.yaw_rate))
        for name, unit, found in told:
            if abs(found) > most:
                raise RecordingError(
                    f"{where}: recording.schedule.commands.{number}.{name} is {found:g} {unit}. Expected at most "
                    f"{most:g} {unit}. It is probably in another unit (mm/s are no m/s): correct it."
                )
    model = None if recording.mass_kg is None else robot_model(robot)
    if recording.mass_kg is None or model is None:
        return
    from hts.sim.models import moving_mass

    mass = moving_mass(model)
    if mass > 0 and not 1 / MASS_FACTOR <= recording.mass_kg / mass <= MASS_FACTOR:
        raise RecordingError(
            f"{where}: recording.mass_kg is {recording.mass_kg:g} kg, the model of '{robot.spec.name}' has {mass:.3g} "
            "kg. It is probably in another unit (g are no kg): weigh the robot and correct it, or leave it out."
        )


def implausible(channels: Mapping[str, Series], per_joint: Mapping[str, bool], spec: RobotSpec) -> list[str]:
    """What cannot be true, one phrase per channel. per_joint: whether a channel follows the robot's joints."""
    found = []
    for name, series in in_standard_units(channels).items():
        if not per_joint[name]:
            continue
        unit = series.channel.unit
        if unit == "N*m":
            limits = np.asarray(spec.torque_limit)
        elif unit == "rad/s":
            limits = np.asarray(spec.velocity_limit)
        elif name == "joint_position":
            low, high = np.asarray(spec.position_limit).T
            middle, limits = (low + high) / 2, (high - low) / 2 + POSITION_MARGIN
            told = [f"its range ({a:g} to {b:g})" for a, b in spec.position_limit]
            found += _beyond(name, unit, series.values, series.values - middle, limits, spec.joint_names, told)
            continue
        else:
            continue
        found += _beyond(name, unit, series.values, series.values, limits, spec.joint_names)
    return found


def outside(name: str, series: Series, limits: tuple[float, float]) -> list[str]:
    """A phrase if any sample lies outside limits that the mapping states."""
    low, high = limits
    values = series.values
    wrong = (values < low) | (values > high)
    if not wrong.any():
        return []
    return [
        (
            f"'{name}' runs from {values.min():g} to {values.max():g} {series.channel.unit}, "
            f"the mapping allows {low:g} to {high:g}"
        )
    ]


def _beyond(
    name: str,
    unit: str,
    shown: np.ndarray,
    centred: np.ndarray,
    limits: np.ndarray,
    joint_names: tuple[str, ...],
    told: Sequence[str] = (),
) -> list[str]:
    """shown, centred: (T, J); limits: (J,) largest |centred|; told: what to call the limit of each joint."""
    size = np.abs(centred)
    typical = np.median(size, axis=0) > limits
    peaks = (size > PEAK_FACTOR * limits).mean(axis=0) > PEAK_SHARE
    bad = np.flatnonzero(typical | peaks)
    if not len(bad):
        return _absurd(name, unit, shown, size, limits, joint_names)
    worst = int(bad[np.argmax((np.median(size, axis=0) / limits)[bad])])
    column = shown[:, worst]
    phrase = (
        f"'{name}' of {joint_names[worst]} runs from {column.min():g} to {column.max():g} {unit}, "
        f"beyond {told[worst] if told else f'its limit ({limits[worst]:g})'}"
    )
    if len(bad) > 1:
        phrase += f", and {len(bad) - 1} more joint{'s' if len(bad) > 2 else ''} likewise"
    # Nearly all: where a whole number changes, resampling leaves a few values in between.
    if (shown == np.round(shown)).mean() > 0.9 and np.all(np.ptp(shown, axis=0) <= 5) and np.all(shown >= 0):
        phrase += "; whole numbers that hardly change, as temperatures do"
    return [phrase]


def _absurd(
    name: str, unit: str, shown: np.ndarray, size: np.ndarray, limits: np.ndarray, joint_names: tuple[str, ...]
) -> list[str]:
    """A phrase for single samples that no machine makes: one of them would rule a whole fit."""
    wrong = size > ABSURD_FACTOR * limits
    if not wrong.any():
        return []
    row, column = np.unravel_index(int(np.argmax(size / limits)), size.shape)
    count = int(wrong.any(axis=1).sum())
    return [
        (
            f"'{name}' of {joint_names[column]} is {shown[row, column]:g} {unit} in sample {row} ({count} such "
            f"sample{'s' if count > 1 else ''}), its limit is {limits[column]:g}: broken rows are "
            "left out by `limits` and `outside: drop`"
        )
    ]
