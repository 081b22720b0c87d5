"""Joint channels that repeat themselves while the joints move on: a logger that had nothing new wrote its last value.

A gap would be refused or filled, and the notes say so; repeated values look like data. A whole message is repeated, so
all joints are, to the last digit.

Where the numbers come from: on the default simulated robot and 26 drawn ones, told 0 to 1 m/s, and on the public logs
of tests/recordings/test_real_logs.py nothing is noted. One of these holds its targets for 6 s at its end, limp, while
it sinks, with joints at a tenth of the speed of its walk and less.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from hts.recordings.recording import Series

NAMES = ("joint_target", "joint_position", "joint_velocity", "joint_torque")
LEAST_SECONDS = 0.2
"""Policies act every 0.02 s or so; this is half a stride of a trot."""
SAME = 1e-6
"""In the unit of the channel: what resampling leaves of a difference of nothing."""
MOVING, AS_BEFORE = 0.5, 0.5
"""rad/s, root mean square of all joints, and as a share of that where the channel changes: a robot that stands, or is
let go, has targets that stay as they are."""
OVER_SECONDS = 1.0
"""Over so many the speed of the joints is averaged: within a stride all of them may be slow for a moment."""
MOST_TOLD = 3


def repeated_notes(channels: Mapping[str, Series], rate_hz: float) -> dict[str, str]:
    """Notes of joint channels that stay the same for all joints while these move, with the times, s from the beginning
    of the recording."""
    speed = joint_speed(channels, rate_hz)
    if speed is None:
        return {}
    found = []
    for name in NAMES:
        if name not in channels or len(channels[name].values) != len(speed):
            continue
        values = channels[name].values.reshape(len(speed), -1).astype(np.float64)
        same = np.asarray((np.abs(np.diff(values, axis=0)) <= SAME).all(axis=1))
        changing = speed[1:][~same]
        least = max(MOVING, AS_BEFORE * float(np.sqrt((changing**2).mean())) if len(changing) else 0.0)
        stretches = [
            f"{first / rate_hz:.2f} to {last / rate_hz:.2f} s"
            for first, last in runs_of(same)
            if last - first >= LEAST_SECONDS * rate_hz and np.sqrt((speed[first : last + 1] ** 2).mean()) > least
        ]
        if stretches:
            more = f" and {len(stretches) - MOST_TOLD} times more" if len(stretches) > MOST_TOLD else ""
            found.append(f"{name} from {', '.join(stretches[:MOST_TOLD])}{more}")
    if not found:
        return {}
    return {
        "repeated_while_moving": f"{'; '.join(found)}: the same for all joints while they move; stale values of the "
        "logger? Cut the log there"
    }


def joint_speed(channels: Mapping[str, Series], rate_hz: float) -> np.ndarray | None:
    """Root mean square of all joints' speeds, rad/s, (T,), by velocities, else by positions; None without either."""
    for name in ("joint_velocity", "joint_position"):
        if name in channels and channels[name].values.ndim == 2 and len(channels[name].values) > 1:
            values = channels[name].values.astype(np.float64)
            if name == "joint_position":
                values = np.gradient(values, 1.0 / rate_hz, axis=0)
            return np.asarray(np.sqrt((values**2).mean(axis=1)))
    return None


def pace_of(channels: Mapping[str, Series], rate_hz: float) -> np.ndarray | None:
    """`joint_speed` (T,) in the root mean square over OVER_SECONDS around each sample; None without one."""
    speed = joint_speed(channels, rate_hz)
    if speed is None:
        return None
    window = np.ones(max(1, min(round(OVER_SECONDS * rate_hz), len(speed))))
    squares = np.convolve(speed**2, window, "same") / np.convolve(np.ones(len(speed)), window, "same")
    return np.asarray(np.sqrt(squares))


def moving(channels: Mapping[str, Series], rate_hz: float) -> np.ndarray | None:
    """Samples (T,) bool around which the joints move, in the mean over OVER_SECONDS; None without `joint_speed`."""
    pace = pace_of(channels, rate_hz)
    return None if pace is None else np.asarray(pace > MOVING)


def runs_of(same: np.ndarray) -> list[tuple[int, int]]:
    """(start, stop) of the stretches of True in bool (T,); of steps from a sample to the next, as of what stays the
    same, the first and last sample of each."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], same.astype(int), [0]])))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))
