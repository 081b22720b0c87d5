"""The robot's model, compiled once for all that is looked at in its logs: to build one takes a tenth of a second."""

from __future__ import annotations

import weakref
from typing import TYPE_CHECKING

from hts.contracts import Robot

if TYPE_CHECKING:
    import mujoco

_last: list[tuple[weakref.ref[Robot], mujoco.MjModel | None]] = []
"""Of the robot that was asked for last; empty before."""


def robot_model(robot: Robot) -> mujoco.MjModel | None:
    """The nominal model, the same object each time: to be read, not changed. None of a robot without one.

    Raises ConfigError for one that MuJoCo does not compile.
    """
    if not _last or _last[0][0]() is not robot:
        from hts.sim.models import compile_model

        model = None if robot.mjcf() is None else compile_model(robot)
        _last[:] = [(weakref.ref(robot), model)]
    return _last[0][1]
