"""The names of the physics engines. Known on the lowest floor, so that a configuration is refused without any of them."""

from __future__ import annotations

from hts.errors import ConfigError, unknown_name

ENGINES = ("auto", "mujoco", "warp")


def check_engine(engine: str) -> None:
    """Raises ConfigError for an engine nobody knows."""
    if engine not in ENGINES:
        raise ConfigError(unknown_name("engine", engine, ENGINES))
