"""The names of the physics engines, on the lowest floor: a configuration is refused without importing any."""

from __future__ import annotations

from hts.errors import ConfigError, unknown_name

ENGINES = ("auto", "mujoco", "warp")


def check_engine(engine: str) -> None:
    """Raises ConfigError for an engine nobody knows."""
    if engine not in ENGINES:
        raise ConfigError(unknown_name("engine", engine, ENGINES))
