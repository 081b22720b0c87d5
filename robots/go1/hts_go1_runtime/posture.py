"""Whether a robot's legs carry it, from the states that a link gives: if they do, motors that idle let it drop.

A leg is folded where its calf joint is within FOLDED of the pose in which this runtime lets go, or folded further: hip
and foot are then at most 2 * 0.213 m * cos(1.2) = 0.15 m apart, so the trunk is 0.12 m above the floor or less, and
0.10 m when it sits down by itself.

Legs that are not folded may hang, on a stool or a crane. Then their motors give hardly any torque, nor do they where a
damped robot has sunk down. One that stands needs, at the knee of each leg in the default pose,

    12 kg * 9.81 m/s2 / 4 * 0.213 m * sin(0.9) = 4.9 N*m        (2.1 with the hip 0.40 m up, its legs nearly straight)

SLACK is less than either and more than a slack motor was seen to give: on a stool the stand-in shows 0.7 N*m as the
mean of a tenth of a second, from noise and from encoders that are off. It assumes that the link's torques are measured
(of a Go1: estimated from motor current); no torque was read on a real robot.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hts_go1_runtime.link import State
from hts_go1_runtime.machine import JOINTS, SIT

FOLDED = 0.1  # rad
SLACK = 2.0  # N*m, of a joint
CALVES = slice(2, 12, 3)


def carried(states: Sequence[State]) -> str:
    """How it shows that the legs carry the robot, by the mean of one or more states; "" if they do not."""
    calves = np.mean([state.q for state in states], axis=0)[CALVES]
    if (calves <= SIT[CALVES] + FOLDED).all():
        return ""
    torque = np.mean([state.tau for state in states], axis=0)
    joint = int(np.abs(torque).argmax())
    if abs(torque[joint]) <= SLACK:
        return ""
    return (
        f"{JOINTS[joint]} gives {abs(torque[joint]):.1f} N·m (slack: at most {SLACK:g}), and calf joints are bent to "
        f"{calves.max():.2f} rad (folded: {SIT[2] + FOLDED:.2f} or less)"
    )
