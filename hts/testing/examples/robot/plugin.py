"""Registers the robot `tiny`. Imports nothing heavy: the factory imports what it makes when it is called."""

from __future__ import annotations

from hts import hookimpl

HTS_API = 2


def make_robot(settings):
    """Robot `tiny`: a cart on two driven wheels."""
    from hts.testing.examples.robot import robot

    return robot.Tiny(robot.Settings(**settings))


@hookimpl
def hts_robots(register):
    register("tiny", make_robot)
