"""Registers the objective `fake` and its instrument. Imports nothing heavy: factories import when they are called."""

from __future__ import annotations

from hts import hookimpl

HTS_API = 2


def make_objective(settings):
    """Objective `fake`: what it is about, in one line."""
    from hts.testing.examples.objective import objective

    return objective.Fake(objective.Settings(**settings))


def make_meter(settings, robot):
    """Instrument `fake_meter`: the sensor of `fake` on a simulated robot."""
    from hts.testing.examples.objective import meter

    return meter.Meter(meter.Settings(**settings))


@hookimpl
def hts_objectives(register):
    register("fake", make_objective)


@hookimpl
def hts_instruments(register):
    register("fake_meter", make_meter)
