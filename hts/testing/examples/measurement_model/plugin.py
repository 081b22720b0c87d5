"""Registers the measurement model `fading`. Imports nothing heavy: the factory imports what it makes when it is
called."""

from __future__ import annotations

from hts import hookimpl

HTS_API = 2


def make_model(settings, context):
    """Measurement model `fading`: what it can learn, in one line."""
    from hts.testing.examples.measurement_model import model

    return model.Fading(model.Settings(**settings), context.signals)


@hookimpl
def hts_measurement_models(register):
    register("fading", make_model)
