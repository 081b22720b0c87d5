"""Registers the robot `dm_walker`, the objective `effort` and the world `walker_lab`. Imports nothing heavy."""

from __future__ import annotations

from hts import hookimpl

HTS_API = 2


@hookimpl
def hts_robots(register):
    register("dm_walker", make_robot)


@hookimpl
def hts_objectives(register):
    register("effort", make_objective)


@hookimpl
def hts_worlds(register):
    register("walker_lab", make_world)


def make_robot(settings):
    """The planar walker of the dm_control suite, task `walk`."""
    from hts_walker import robot

    return robot.Walker(robot.Settings(**settings))


def make_objective(settings):
    """Electrical energy per metre, measured in `walker_lab` only."""
    from hts_walker import objective

    return objective.Effort(objective.Settings(**settings))


def make_world(settings, context):
    """A walker that is not the simulated one: heavier, with more damping and a power meter."""
    from hts_walker import lab

    return lab.WalkerLab(lab.Settings(**settings), context)
