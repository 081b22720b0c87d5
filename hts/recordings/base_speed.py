"""Whether the velocity of the trunk can be that of a robot which was told to walk: other units, signs, frames.

Over what was commanded steadily, three numbers tell: how fast it went for how fast it was told (size), how much of
that in the told direction (along), and how much to the left of it (aside), each as a share of the commanded speed.

Where the thresholds come from: on the default simulated robot and 26 drawn ones, told 0.5 and 1 m/s ahead, turning and
not, and 0.36 m/s slantwise, along was 0.86 to 1.15 and aside -0.08 to
0.10. No log of a real robot at hand has both commands and a velocity of the trunk, so only what no walking robot does
is refused.
"""

from __future__ import annotations

import math
from collections.abc import Collection

import numpy as np
from scipy.ndimage import maximum_filter1d, minimum_filter1d

from hts.contracts import Robot
from hts.contracts.speeds import fastest
from hts.errors import RecordingError
from hts.recordings.leg_speed import leg_speed
from hts.recordings.on_schedule import command_at
from hts.recordings.recording import Recording

VELOCITY, COMMAND = "base_velocity", "command"
TOLD = 0.3
"""m/s: who is told less may stand."""
SETTLE_SECONDS, LEAST_SECONDS = 2.0, 3.0
"""After a command changed, and of what is left, s."""
CHANGED = 0.02
"""m/s or rad/s within which a command is the same."""
OTHER_UNIT = 10.0
"""Size from which on it is another unit: cm/s are 100 times, mm/s 1000 times as many."""
ELSEWHERE = 0.3
"""Share of the speed that lies in the told direction, below which it is that of other axes: 73 degrees off."""
WALKS = 0.5
"""Size from which on a robot walks, wherever to."""
ANOTHER_UNIT = "It is probably in another unit (mm/s are no m/s): correct unit or scale"
OTHER_AXES = (
    "Expected is that of the trunk in its own axes, x forward, y left: correct sign or columns, or turn it there"
)
MUCH = 2.5
"""Along from which on it is told: km/h are 3.6 times as many. Below ELSEWHERE it is told, too."""
FAST, TIMES_LEGS, LEGS_WALK = 1.7, 2.0, (0.4, 1.4)
"""Along from which on the legs are asked: knots are 1.94 times m/s, miles an hour 2.24, feet a second 3.28. Where they
walk about as they were told, between these shares of the commands, and the trunk goes so many times as fast as they
say, it is in another unit: legs that are thrown forward do not double a speed."""


def velocity_notes(recording: Recording, robot: Robot, where: str, stated: Collection[str] = ()) -> dict[str, str]:
    """Notes where `base_velocity` is hardly that of a robot which was told to walk as it was, but may be right.

    What was told is the channel `command`, else the schedule, if somebody stated it. where: begins messages; stated:
    names of channels whose limits a mapping states, which is a person's word for them. Raises RecordingError where it
    is in another unit, counted the other way or along other axes than the trunk's. Nothing is said of a fall.
    """
    if VELOCITY in stated or VELOCITY not in recording.channels or recording.fell:
        return {}
    series = recording.channels[VELOCITY]
    if series.channel.unit != "m/s" or series.values.shape[1:] != (3,):
        return {}
    velocity = series.values[:, :2].astype(np.float64)
    most = fastest(robot.spec)
    typical = float(np.median(np.hypot(*velocity.T)))
    if typical > most:
        raise _refusal(where, f"is {typical:.4g} m/s at the median, more than the {most:g} m/s of any such robot")
    told = told_commands(recording)
    if told is None:
        return {}
    steady = unchanged(told, recording.rate_hz) & (np.hypot(told[:, 0], told[:, 1]) >= TOLD)
    if steady.sum() < LEAST_SECONDS * recording.rate_hz:
        return {}
    told, mean = told[steady, :2], mean_over(velocity, round(recording.rate_hz))[steady]
    squares = float((told**2).sum())
    along = float((mean * told).sum()) / squares
    aside = float((mean[:, 1] * told[:, 0] - mean[:, 0] * told[:, 1]).sum()) / squares
    size = float(np.hypot(*mean.T).mean() / np.hypot(*told.T).mean())
    if size > OTHER_UNIT:
        raise _refusal(where, f"is {size:.3g} times as fast as the commands")
    if size > WALKS and along < ELSEWHERE * size:
        raise _refusal(where, _direction(along, aside, size), OTHER_AXES)
    legs = _of_legs(recording, robot, steady, told) if along > FAST else None
    if legs is not None and LEGS_WALK[0] < legs < LEGS_WALK[1] and along > TIMES_LEGS * legs:
        text = f"is {along:.2g} times the commands, but the legs walk at {legs:.2g} times them (feet that stand)"
        hint = "It is probably in another unit (km/h are 3.6, miles an hour 2.24 times m/s): correct unit or scale"
        raise _refusal(where, text, hint)
    if along > MUCH or size < ELSEWHERE:
        return {
            "base_velocity_scale": (
                f"{along:.2g} times the commands where these ask for {TOLD:g} m/s or more: is it in another unit (km/h "
                "are 3.6 times m/s), or did the robot not do as it was told?"
            )
        }
    return {}


def _of_legs(recording: Recording, robot: Robot, steady: np.ndarray, told: np.ndarray) -> float | None:
    """Share of the commanded speed at which the legs walk along it; None where that cannot be told. steady: samples
    (T,) bool; told: of these, (k, 2), m/s."""
    velocity = leg_speed(recording, robot)
    if velocity is None:
        return None
    kept = steady[: len(velocity)]
    told = told[: int(kept.sum())]
    return float((velocity[kept] * told).sum() / (told**2).sum()) if len(told) else None


def _refusal(where: str, found: str, hint: str = ANOTHER_UNIT) -> RecordingError:
    return RecordingError(f"{where}: '{VELOCITY}' {found}. {hint}; if it is right, say so with `limits`.")


def _direction(along: float, aside: float, size: float) -> str:
    """In words, a velocity that does not lie in the told direction."""
    if along < -WALKS * size:
        looks = "as if it were counted the other way (sign: -1)"
    elif abs(aside) > WALKS * size:
        looks = "as if forward and sideways were swapped"
    else:
        looks = "now here, now there"
    return (
        f"does not lie in the commanded direction ({along:.2f} times the command along it, {aside:.2f} to its left): "
        f"{looks}, or in the axes of the world"
    )


def told_commands(recording: Recording) -> np.ndarray | None:
    """Commanded vx, vy, m/s, and yaw rate, rad/s, (T, 3); None where nobody said what was commanded."""
    logged = recording.channels.get(COMMAND)
    if logged is not None and logged.values.shape[1:] == (3,):
        return logged.values.astype(np.float64)
    commands = recording.schedule.commands
    if "schedule" in recording.notes or not all(command.is_velocity for command in commands):
        return None
    return np.array([(command.vx, command.vy, command.yaw_rate) for command in commands])[command_at(recording)]


def unchanged(told: np.ndarray, rate_hz: float) -> np.ndarray:
    """Samples (T,) bool at which the command had been the same for SETTLE_SECONDS: all of it within CHANGED, so that
    one that changes by little from sample to sample is not. told: (T, 3), m/s, m/s, rad/s."""
    before = math.ceil(SETTLE_SECONDS * rate_hz)
    if len(told) <= before:
        return np.zeros(len(told), dtype=np.bool_)
    over = {"size": before + 1, "axis": 0, "origin": before - (before + 1) // 2}  # that sample, and those before it
    spread = maximum_filter1d(told, **over) - minimum_filter1d(told, **over)
    return np.asarray((spread <= CHANGED).all(axis=1) & (np.arange(len(told)) >= before))


def mean_over(values: np.ndarray, window: int) -> np.ndarray:
    """Means (T, C) of values (T, C) over the `window` samples up to each."""
    sums = np.concatenate([np.zeros((1, values.shape[1])), np.cumsum(values, axis=0)])
    end = np.arange(1, len(values) + 1)
    start = np.maximum(end - max(window, 1), 0)
    return np.asarray((sums[end] - sums[start]) / (end - start)[:, None])
