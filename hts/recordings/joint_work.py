"""Whether the joints do work on the whole, as those of a machine that walks or repeats a movement: torque x velocity.

A movement that comes back to where it began does no work against gravity, and friction and impacts take some away: what
the joints put in is above zero. As a share of what passes through them either way, integral tau qd over integral
|tau qd|, it was 0.30 and 0.39 on two public logs of a walking quadruped and 0.27 on one under a learned policy
(tests/recordings/test_real_logs.py), so with torques or velocities counted the other way it would be minus that. An arm
that moves to and fro had 0.01. Walking down a steep slope may be below zero, too, so it is noted and not refused.
"""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from hts.recordings.recording import Recording

NAMES = ("joint_torque", "joint_velocity")
LEAST_SECONDS = 5.0
MOVING_SPEED, MOVING_SHARE = 1.0, 0.5
"""rad/s of the fastest joint, and the share of a log in which it is at least that: others stand, or hardly move."""
COMES_BACK = 0.1
"""How far the joints end from where they began, as a share of the way that they went."""
TAKEN = -0.2
"""Share of work from which on it is told. Going down a slope of 15 degrees takes about that much of such a walk."""


def work_notes(recording: Recording, stated: Collection[str] = ()) -> dict[str, str]:
    """A note where the joints take work instead of doing it, though the movement repeats. Nothing is said of a log
    without torques and velocities of the same joints, of one that hardly moves, that ends elsewhere or in a fall, nor
    where `joint_target` shows better whether torques can be right (`pd_torque`).

    stated: names of channels whose limits a mapping states, which is a person's word for them.
    """
    channels = recording.channels
    if recording.fell or "joint_target" in channels or any(name not in channels or name in stated for name in NAMES):
        return {}
    torque, speed = (channels[name].values.astype(np.float64) for name in NAMES)
    if torque.shape != speed.shape or torque.ndim != 2 or len(torque) < LEAST_SECONDS * recording.rate_hz:
        return {}
    if channels["joint_torque"].channel.unit != "N*m" or channels["joint_velocity"].channel.unit != "rad/s":
        return {}
    if (np.abs(speed).max(axis=1) > MOVING_SPEED).mean() < MOVING_SHARE:
        return {}
    passed = float(np.abs(torque * speed).sum())
    if np.abs(speed.sum(axis=0)).sum() > COMES_BACK * np.abs(speed).sum() or passed == 0:
        return {}
    share = float((torque * speed).sum()) / passed
    if share > TAKEN:
        return {}
    watts = float((torque * speed).sum(axis=1).mean())
    return {
        "joint_torque_takes_work": (
            f"joint_torque x joint_velocity is {watts:.3g} W in the mean ({share:.0%} of what passes through them). "
            "Joints of a machine that walks do work: is one of them counted the other way (sign: -1)? Walking down "
            "a steep slope may look so"
        )
    }
