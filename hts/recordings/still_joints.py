"""A joint of which one quantity keeps one number while the joint itself moves: a column that was not being read.

Limits pass it, since nothing lies outside of them, and what looks at all joints together passes it, since the others
are right. A model that is fitted to it learns that this joint needs no torque, and meets one that does in simulation.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping

import numpy as np

from hts.contracts import RobotSpec
from hts.errors import RecordingError
from hts.recordings.recording import Series
from hts.recordings.repeated import AS_BEFORE, runs_of
from hts.recordings.unread import LONGEST_SECONDS

POSITION, VELOCITY, TORQUE = "joint_position", "joint_velocity", "joint_torque"
WITNESSES = {POSITION: (VELOCITY,), VELOCITY: (POSITION,), TORQUE: (VELOCITY, POSITION)}
"""What is looked at -> by what it is told that the joint moves, the first of them that is there and changes."""
MOVING = 0.5
"""rad/s, standard deviation over a stretch: the gears alone ask for torque then."""
SAME = 1e-6
"""In the unit of the channel: what resampling leaves of a difference of nothing."""


def check_still_joints(
    channels: Mapping[str, Series], spec: RobotSpec, rate_hz: float, where: str, stated: Collection[str] = ()
) -> None:
    """Raise RecordingError for a joint whose position, velocity or torque keeps one number for more than
    LONGEST_SECONDS while another of these says that it moves, as far as where it changes.

    where: begins the message; stated: names of channels whose limits a mapping states, which is a person's word for
    them.
    """
    for name, witnesses in WITNESSES.items():
        if name not in channels or name in stated:
            continue
        values = channels[name].values.astype(np.float64)
        if values.ndim != 2 or values.shape[1] != spec.num_joints:
            continue
        found = {}
        for joint in range(spec.num_joints):
            speed = _speed(channels, witnesses, joint, len(values), rate_hz)
            longest = None if speed is None else _longest(values[:, joint], speed, rate_hz)
            if longest is not None:
                found[joint] = longest
        if found:
            joint = next(iter(found))
            first, last = found[joint]
            others = f", and that of {len(found) - 1} more likewise" if len(found) > 1 else ""
            raise RecordingError(
                f"{where}: '{name}' of {spec.joint_names[joint]} is {values[first, joint]:.4g} "
                f"{channels[name].channel.unit} from {first / rate_hz:.2f} to {last / rate_hz:.2f} s, while that joint "
                f"moves{others}. Expected another number after at most {LONGEST_SECONDS:g} s: its column was probably "
                "not being written. Record again, or cut the log there; if it is right, say so with `limits`."
            )


def _speed(
    channels: Mapping[str, Series], witnesses: Collection[str], joint: int, samples: int, rate_hz: float
) -> np.ndarray | None:
    """How fast the joint moves by the first witness that changes, rad/s, (samples,); None where none does."""
    for name in witnesses:
        if name not in channels or channels[name].values.ndim != 2 or len(channels[name].values) != samples:
            continue
        column = channels[name].values[:, joint].astype(np.float64)
        if np.ptp(column) > SAME:
            return np.gradient(column, 1.0 / rate_hz) if name == POSITION else column
    return None


def _longest(column: np.ndarray, speed: np.ndarray, rate_hz: float) -> tuple[int, int] | None:
    """First and last sample of the longest stretch in which the column (T,) stays the same for too long while the joint
    moves; None without one."""
    same = np.abs(np.diff(column)) <= SAME
    changing = speed[1:][~same]
    least = max(MOVING, AS_BEFORE * float(changing.std()) if len(changing) > 1 else 0.0)
    runs = [
        (first, last)
        for first, last in runs_of(same)
        if last - first > LONGEST_SECONDS * rate_hz and speed[first : last + 1].std() > least
    ]
    return max(runs, key=lambda run: run[1] - run[0], default=None)
