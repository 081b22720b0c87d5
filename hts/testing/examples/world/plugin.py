"""Registers the world `hoist`. Imports nothing heavy: the factory imports what it makes when it is called."""

from __future__ import annotations

from hts import hookimpl

HTS_API = 2


def make_world(settings, context):
    """World `hoist`: where policies run, in one line."""
    from hts.testing.examples.world import world

    return world.Hoist(world.Settings(**settings), context)


@hookimpl
def hts_worlds(register):
    register("hoist", make_world)
