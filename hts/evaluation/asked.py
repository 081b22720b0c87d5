"""A request to a world, after which whatever goes wrong there is one line that names the world and the call."""

from __future__ import annotations

from typing import Any

from hts.contracts import World
from hts.guarded import guarded


def asked(world: World, call: str, *values: Any) -> Any:
    """What the world's method of that name gives. Its own HtsErrors pass; PluginError for anything unforeseen."""
    return guarded(f"World '{world.name}': {call}()", lambda: getattr(world, call)(*values))
