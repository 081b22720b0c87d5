"""Registers the instrument `warmth`. Imports nothing heavy: the factory imports what it makes when it is called."""

from __future__ import annotations

from hts import hookimpl

HTS_API = 2


def make_instrument(settings, robot):
    """Instrument `warmth`: what it measures, in one line."""
    from hts.testing.examples.instrument import instrument

    return instrument.Warmth(instrument.Settings(**settings))


@hookimpl
def hts_instruments(register):
    register("warmth", make_instrument)
