"""What is asked of a visit on the command line."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Options:
    """rows: names, none: all without a log; idle_seconds: to measure the idle levels, 0: not; warmup_seconds: None: the
    bundle's; first_run: walk each policy slowly and weakly, record nothing; mass_kg: for the mapping; vouched: hashes
    of policies that failed the gate and are to be walked; external: channels that a sensor of its own logs; at_limit:
    record rows at a limit of the command too; frozen_real_seconds: None: the bundle's; straight: m, on which it
    walks to and fro, None: straight on."""

    rows: tuple[str, ...] = ()
    idle_seconds: float = 10.0
    warmup_seconds: float | None = None
    first_run: bool = False
    mass_kg: float | None = None
    vouched: tuple[str, ...] = ()
    external: tuple[str, ...] = ()
    at_limit: bool = False
    frozen_real_seconds: float | None = None
    straight: float | None = None
