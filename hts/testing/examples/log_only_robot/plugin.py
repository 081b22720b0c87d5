"""Registers the robot `logged`. Imports nothing heavy: the factory imports what it makes when it is called."""

from __future__ import annotations

from hts import hookimpl

HTS_API = 2


def make_robot(settings):
    """Robot `logged`: which machine it is, in one line. Known by its logs alone."""
    from hts.contracts import LogOnlyRobot
    from hts.testing.examples.log_only_robot import robot

    robot.Settings(**settings)
    return LogOnlyRobot(robot.SPEC, robot.CHANNELS)


@hookimpl
def hts_robots(register):
    register("logged", make_robot)
