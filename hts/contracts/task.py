"""A task: what a robot is asked to do, and how one sees in what was recorded whether it does it."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from numbers import Real
from typing import Any, ClassVar

from hts.config import NOTHING, Command, ScheduleConfig
from hts.errors import ConfigError

MOST_OF_THE_TIME = 0.5  # of the seconds of a trial


class Task(ABC):
    """What is commanded, what of it was achieved, and whether that counts as doing the task.

    Numbers of a real robot are made of the seconds in which the task was done: otherwise whoever stands still measures
    cheapest. Candidates are judged by the same rule in simulation.

    quantity: what `achieved` gives, as tables call it; unit: of it and of the set-points; channels: the sim channels
    that `achieved` reads, which env and recordings must have; set_points: what may be commanded: these numbers; any
    number (None); or nothing at all (empty): a task that is done in one way. Its set-point is 0 where one must stand.
    can_hold: whether the command can be trimmed by what is achieved until that is the set-point on average (see
    `World.hold_speed`): only a commanded velocity can.
    """

    quantity: ClassVar[str]
    unit: ClassVar[str]
    channels: ClassVar[tuple[str, ...]]
    set_points: ClassVar[tuple[float, ...] | None] = ()
    can_hold: ClassVar[bool] = False

    @abstractmethod
    def achieved(self, channels: Mapping[str, Any]) -> Any:
        """How far the task was done at each sample: channels (..., *shape) -> (...,), in `unit`.

        It gets arrays of numpy and tensors of torch: index them and use operators. Its mean over a second is judged.
        """

    @abstractmethod
    def done(self, achieved: Any, set_point: Any, tolerance: float) -> Any:
        """Whether a second counts. achieved: its mean, a number or an array; set_point: what was commanded; tolerance:
        `evaluation.speed_tolerance` or `simulation_test.speed_tolerance`, for tasks that have a use for it."""

    def does_it(self, achieved: float, share_done: float, set_point: float, tolerance: float) -> bool:
        """Whether a candidate does the task in simulation. achieved: mean of its trials; share_done: of their seconds.
        By default half of them must count."""
        return share_done >= MOST_OF_THE_TIME

    # ------------------------------------------------------------------------------- what follows from that

    @property
    def defaults(self) -> tuple[float, ...]:
        """The set-points that a run takes where nobody says which; empty where any number would do."""
        return () if self.set_points is None else self.set_points or (NOTHING,)

    def command(self, set_point: float, seconds: float) -> Command:
        """The set-point, held for so long, s."""
        return Command.model_validate({"seconds": seconds, "set_point": set_point if self.set_points else None})

    def schedule(self, set_point: float, seconds: float) -> ScheduleConfig:
        """A schedule of that alone."""
        return ScheduleConfig(commands=(self.command(set_point, seconds),))

    def at(self, set_point: float) -> str:
        """ " at 0.8 m/s", for the middle of a sentence; empty where nothing is commanded."""
        return "" if self.set_points == () else f" at {set_point:g} {self.unit}"

    def check_hold(self, where: str) -> None:
        """Raises ConfigError for a task that cannot hold; where: the key that asks for it."""
        if not self.can_hold:
            raise ConfigError(
                f"{where}: expected false, found true. This robot's task is judged by its {self.quantity}; only a "
                "robot that follows a commanded velocity can hold a speed. Leave the key out."
            )

    def check_tolerance(self, tolerance: float, where: str) -> None:  # noqa: B027 - most have their own use for it
        """Raises ConfigError for a tolerance that this task has no use for; by default it takes any. where: its key."""

    def check(self, set_points: Sequence[float], where: str) -> None:
        """Raises ConfigError for a set-point that this task does not have, or that is no finite number; where: the key
        or the option it stands under."""
        for found in set_points:
            if not _is_finite(found):
                raise ConfigError(f"{where}: expected a finite number, found {found!r}.")
        if self.set_points is None:
            return
        for found in set_points:
            if found not in self.defaults:
                known = " or ".join(f"{one:g}" for one in self.set_points)
                expected = f"a set-point of the task, {known} {self.unit}" if known else "nothing commanded"
                raise ConfigError(
                    f"{where}: expected {expected}, found {found:g}. This robot's task is judged by its "
                    f"{self.quantity}; leave the key out."
                )

    def check_schedule(self, schedule: ScheduleConfig, where: str) -> None:
        """Raises ConfigError where a velocity is commanded to a task that follows none, or the other way round."""
        for number, command in enumerate(schedule.commands):
            if command.is_velocity:
                raise ConfigError(
                    f"{where}.commands.{number}: commands a velocity, but this robot's task follows none. Write "
                    f"{{seconds: {command.seconds:g}, set_point: {'NUMBER' if self.set_points else 'null'}}}."
                )
        self.check([command.commanded for command in schedule.commands], where)


def _is_finite(found: Any) -> bool:
    """Whether it is a number, and neither infinite nor NaN."""
    return isinstance(found, Real) and not isinstance(found, bool) and math.isfinite(found)


class FollowVelocity(Task):
    """Move straight ahead at a commanded velocity, which is any number of m/s. The task of a robot that names no other.

    A second counts if the mean forward velocity is within the tolerance, relative to the command (the paper's
    protocol); a command of 0 m/s therefore has no second that counts: ±10 % of nothing is nothing.
    """

    quantity = "forward speed"
    unit = "m/s"
    channels = ("base_velocity",)
    set_points = None
    can_hold = True

    def achieved(self, channels: Mapping[str, Any]) -> Any:
        """The first component of `base_velocity`, m/s."""
        return channels["base_velocity"][..., 0]

    def done(self, achieved: Any, set_point: Any, tolerance: float) -> Any:
        return abs(achieved - set_point) < tolerance * abs(set_point)

    def does_it(self, achieved: float, share_done: float, set_point: float, tolerance: float) -> bool:
        """By the mean speed of the whole trial, and in most of its seconds: a policy that stands in some sessions and
        hurries in others has the right mean, and a head-to-head refuses it."""
        return abs(achieved - set_point) <= tolerance * set_point and share_done >= MOST_OF_THE_TIME

    def command(self, set_point: float, seconds: float) -> Command:
        return Command(seconds=seconds, vx=set_point)

    def check(self, set_points: Sequence[float], where: str) -> None:
        """Who is judged walks: no second at a command of 0 m/s would count."""
        super().check(set_points, where)
        for found in set_points:
            if not found > 0:
                raise ConfigError(f"{where}: expected a number greater than 0, found {found:g}.")

    def check_tolerance(self, tolerance: float, where: str) -> None:
        """It is relative, so that with 1 who stands still would do what was commanded."""
        if not tolerance < 1:
            raise ConfigError(
                f"{where}: expected a share below 1, found {tolerance:g}. It is relative to the commanded speed: 0.1 "
                "is ±10 %."
            )

    def check_schedule(self, schedule: ScheduleConfig, where: str) -> None:
        for number, command in enumerate(schedule.commands):
            if not command.is_velocity:
                raise ConfigError(
                    f"{where}.commands.{number}: this robot follows a commanded velocity. Write vx, m/s, instead of "
                    "set_point."
                )


VELOCITY = FollowVelocity()
"""There is nothing to set in it, so one is enough."""
