"""What a robot is asked to do over time: commanded velocities, or set-points of another task."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pydantic import ConfigDict, Field, SerializerFunctionWrapHandler, model_serializer, model_validator

from hts.config_base import Config

NOTHING = 0.0
"""The set-point of a task in which nothing is commanded, wherever one has to stand."""


def _velocity_or_set_point(schema: dict[str, Any]) -> None:
    """In the schema: either of the two."""
    schema["required"] = ["seconds"]
    schema["anyOf"] = [{"required": ["vx"]}, {"required": ["set_point"]}]


class Command(Config):
    """A stretch of a schedule: the commanded velocity, or the set-point of another task, held for so long."""

    model_config = ConfigDict(  # infinity is not written as null
        json_schema_extra=_velocity_or_set_point, ser_json_inf_nan="constants"
    )

    seconds: float = Field(allow_inf_nan=True, gt=0, description="duration, s")
    vx: float = Field(description="commanded forward velocity, m/s")
    vy: float = Field(0.0, description="commanded sideways velocity, m/s")
    yaw_rate: float = Field(0.0, description="commanded yaw rate, rad/s (0: the operator keeps the heading)")
    set_point: float | None = Field(
        None,
        allow_inf_nan=False,
        description="instead of velocities, for a robot with another task: its set-point, in the task's own unit; "
        "null where that task has nothing to command",
    )

    @property
    def is_velocity(self) -> bool:
        """Whether it commands a velocity, or a set-point of another task."""
        return "set_point" not in self.model_fields_set

    @property
    def commanded(self) -> float:
        """What is to be achieved: the forward velocity, m/s, or the set-point; `NOTHING` where nothing is commanded."""
        if self.is_velocity:
            return self.vx
        return NOTHING if self.set_point is None else self.set_point

    @model_validator(mode="before")
    @classmethod
    def _either(cls, given: Any) -> Any:
        """One of the two is needed: `vx`, unless there is a set-point, beside which no velocity may stand."""
        if not isinstance(given, Mapping) or "set_point" not in given:
            return given
        velocities = [name for name in ("vx", "vy", "yaw_rate") if name in given]
        if velocities:
            raise ValueError(f"`set_point` stands instead of a velocity, found {velocities[0]} beside it")
        return {**given, "vx": 0.0}

    @model_serializer(mode="wrap")
    def _as_written(self, plain: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Without what is not commanded. Recordings and requests are known by the content of their schedule, so a
        velocity is written as ever."""
        wanted = ("seconds", "vx", "vy", "yaw_rate") if self.is_velocity else ("seconds", "set_point")
        return {name: value for name, value in plain(self).items() if name in wanted}


class ScheduleConfig(Config):
    """Commanded velocities, or set-points of another task, over time."""

    model_config = ConfigDict(ser_json_inf_nan="constants")

    commands: tuple[Command, ...] = Field(min_length=1, description="one after the other")

    @property
    def seconds(self) -> float:
        return sum(command.seconds for command in self.commands)
