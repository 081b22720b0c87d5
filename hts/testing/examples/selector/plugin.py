"""Registers the selector `plain`. Imports nothing heavy: the factory imports what it makes when it is called."""

from __future__ import annotations

from hts import hookimpl

HTS_API = 2


def make_selector(settings):
    """Selector `plain`: how it chooses, in one line."""
    from hts.testing.examples.selector import selector

    return selector.Plain(selector.Settings(**settings))


@hookimpl
def hts_selectors(register):
    register("plain", make_selector)
