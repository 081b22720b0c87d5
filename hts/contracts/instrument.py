"""An instrument: a simulated sensor of a real channel on a twin. Learning code never sees one."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np

    from hts.channels import Channel


@dataclass
class PhysicsSample:
    """One physics step of W simulated robots, as instruments see it. Arrays (W, J) or (W, F), SI units.

    motor_torque: made by the motor current, seen at the joint, N·m; joint_velocity rad/s;
    foot_force: normal, N; foot_speed: normal speed of each foot just before this step, m/s (downwards positive);
    foot_mass: effective mass of each foot along the normal, kg; dt: s.
    current_torque: what the motor's current would make with its nominal torque constant, N·m, where a reality's motors
    make something else of it; None: as motor_torque.
    """

    motor_torque: np.ndarray
    joint_velocity: np.ndarray
    foot_force: np.ndarray
    foot_speed: np.ndarray
    foot_mass: np.ndarray
    dt: float
    current_torque: np.ndarray | None = None

    def at(self, step: int) -> PhysicsSample:
        """One of K steps of a sample whose arrays are (K, W, J) and (K, W, F)."""
        current = None if self.current_torque is None else self.current_torque[step]
        return PhysicsSample(
            self.motor_torque[step],
            self.joint_velocity[step],
            self.foot_force[step],
            self.foot_speed[step],
            self.foot_mass[step],
            self.dt,
            current,
        )


@dataclass(frozen=True)
class Fact:
    """A public fact about the real machine: something that the instrument shows lies between two bounds.

    name: for tables; low, high: the bounds, in `unit`; unit: of the bounds and of what `reading` gives;
    speed: that the robot's own policy is commanded, m/s; 0: standing. reading: its value from what was recorded, warm
    and at that speed (channel -> (T, *shape)), and from the idle level of each channel. source: where it is published.
    """

    name: str
    speed: float
    low: float
    high: float
    unit: str
    source: str
    reading: Callable[[Mapping[str, np.ndarray], Mapping[str, float]], float]


@dataclass(frozen=True)
class Reading:
    """A quantity that both this instrument and a lab's recordings of its robot give, so that one can be held against
    the other (`hts realities draw --like`).

    name: for tables; unit: of what `reading` gives; channels: that it reads, of an idle one those whose levels it
    reads; reading: as `Fact.reading`; idle: it needs the idle levels alone.
    """

    name: str
    unit: str
    channels: tuple[str, ...]
    reading: Callable[[Mapping[str, np.ndarray], Mapping[str, float]], float]
    idle: bool = False


class Instrument(ABC):
    """A simulated sensor of a real channel on a twin. Learning code never sees one.

    It keeps its hidden state (temperatures, charge, filters) for W robots at once, across policy swaps.
    """

    channels: tuple[Channel, ...]
    idles_at_rest: bool = True
    """Whether motors that are on and hold still without torque read as idle ones do. False: they do not, as of drives
    that draw something once they are enabled; then nobody holds `read` at rest against `idle`."""

    @abstractmethod
    def reset(self, num_worlds: int, rng: np.random.Generator) -> None:
        """A fresh instrument on each of W robots."""

    @abstractmethod
    def step(self, sample: PhysicsSample) -> None:
        """One physics step passes."""

    def advance(self, samples: PhysicsSample) -> None:
        """The K physics steps between two readings pass: arrays with K before the rest. By default `step` for each; an
        instrument that is faster at once may do them at once, to the same result."""
        for step in range(len(samples.motor_torque)):
            self.step(samples.at(step))

    @abstractmethod
    def read(self) -> Mapping[str, np.ndarray]:
        """What the instrument shows now, channel name -> (W, *shape)."""

    @abstractmethod
    def idle(self) -> Mapping[str, float]:
        """Level of each channel with electronics on and motors idle, as someone would read it off."""

    def exact(self) -> Mapping[str, np.ndarray]:
        """What `read` would show without noise, rounding, filter and delay: means since the last call of this,
        channel name -> (W, *shape). For who holds measurements against the truth on a twin, and for `hts oracle
        --in-simulation`; never recorded.

        The channel itself, its idle level included; what an objective makes of it is `truth`. By default empty: this
        instrument cannot tell.
        """
        return {}

    def exact_idle(self) -> Mapping[str, float]:
        """`idle` without the errors of whoever reads it off. By default as `idle`."""
        return self.idle()

    def settle(self) -> None:  # noqa: B027 - most have nothing slow
        """Bring slow hidden state (heat) to the steady state of the steps since the last reset or settle."""

    def describe(self) -> Mapping[str, Any]:
        """Its parameters, for the twin's hash and the calibration table."""
        return {}

    def supply(self) -> np.ndarray | None:
        """Voltage of the motors' supply now, as a share of the rated one, (W,); None: it simulates no supply."""
        return None

    def truth(self) -> Mapping[str, np.ndarray]:
        """What only a simulator knows: channel -> (W,), what an objective on that channel pays for in the end, without
        noise, delay and filter, and without what no policy can change; in a unit of the instrument's own.

        A mean over the steps since it was last asked, or the level that there is now. Never recorded: `hts oracle`
        asks, and checks do. By default nothing is told, and there is no oracle for the channels.
        """
        return {}

    def conditions(self) -> Mapping[str, np.ndarray]:
        """What somebody would note of each session at its start, name -> (W,), such as the day's temperature.

        Asked after `reset`; only what differs from session to session. By default nothing.
        """
        return {}

    def facts(self) -> Sequence[Fact]:
        """Public facts about the real machine that a plausible reality agrees with. By default none are known."""
        return ()

    def readings(self) -> Sequence[Reading]:
        """What of it a lab's own recordings show as well. By default nothing."""
        return ()
