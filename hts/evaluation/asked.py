"""A request to a world, after which whatever goes wrong there is one line that names the world and the call."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any

from hts.contracts import World
from hts.errors import PluginError
from hts.evaluation.head_to_head import ROLES
from hts.guarded import guarded
from hts.recordings.recording import Recording

Check = Callable[[Sequence[Recording]], None]
"""Raises RecordingError for recordings that cannot be judged as they are."""


def asked(world: World, call: str, *values: Any) -> Any:
    """What the world's method of that name gives. Its own HtsErrors pass; PluginError for anything unforeseen."""
    return guarded(f"World '{world.name}': {call}()", lambda: getattr(world, call)(*values))


def complete(
    world: World, call: str, found: Iterable[Recording] | None, speeds: Sequence[float], check: Check | None = None
) -> list[Recording]:
    """What a world gave for one policy. Raises PluginError where a role has no recording at a speed that was asked for:
    a speed that nobody walked would count as one that was kept. check: what else is asked of the recordings, before
    anything is made of them."""
    return _complete(f"World '{world.name}': {call}()", found, speeds, check)


def complete_each(
    world: World,
    call: str,
    found: Iterable[Iterable[Recording]] | None,
    policies: int,
    speeds: Sequence[float],
    check: Check | None = None,
) -> list[list[Recording]]:
    """What it gave for several: so many lists, each as `complete` wants it, else PluginError."""
    who, lists = f"World '{world.name}': {call}()", list(found or ())
    if len(lists) != policies:
        raise PluginError(f"{who} gave {len(lists)} lists of recordings for {policies} policies, expected one each.")
    return [
        _complete(f"{who}, policy {number} of {policies}", one, speeds, check) for number, one in enumerate(lists, 1)
    ]


def _complete(
    who: str, found: Iterable[Recording] | None, speeds: Sequence[float], check: Check | None
) -> list[Recording]:
    recordings = list(found or ())
    there = {(recording.role, command.commanded) for recording in recordings for command in recording.schedule.commands}
    for speed in speeds:
        for role in ROLES:
            if (role, speed) not in there:
                raise PluginError(
                    f"{who} gave {len(recordings)} recordings and none of the {role} at {speed:g}. Expected blocks of "
                    "both roles at every speed that was asked for (docs/authors/world.md)."
                )
    if check is not None:
        check(recordings)
    return recordings
