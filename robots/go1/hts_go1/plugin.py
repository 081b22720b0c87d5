"""Registers the robot `go1`. Imports nothing heavy."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hts import hookimpl

if TYPE_CHECKING:
    from collections.abc import Callable

    from hts.contracts import Robot, Settings

HTS_API = 2


def make_go1(settings: Settings) -> Robot:
    """Robot `go1`: the Unitree Go1, twelve joints, with a policy that walks."""
    from hts_go1.robot import Go1, Go1Settings

    return Go1(Go1Settings(**dict(settings)))


@hookimpl
def hts_robots(register: Callable[[str, Callable[..., Robot]], None]) -> None:
    """Offer the Go1."""
    register("go1", make_go1)
