"""An instrument: a simulated sensor of a real channel on a twin. Learning code never sees one."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
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
    """

    motor_torque: np.ndarray
    joint_velocity: np.ndarray
    foot_force: np.ndarray
    foot_speed: np.ndarray
    foot_mass: np.ndarray
    dt: float


class Instrument(ABC):
    """A simulated sensor of a real channel on a twin. Learning code never sees one.

    It keeps its hidden state (temperatures, charge, filters) for W robots at once, across policy swaps.
    """

    channels: tuple[Channel, ...]

    @abstractmethod
    def reset(self, num_worlds: int, rng: np.random.Generator) -> None:
        """A fresh instrument on each of W robots."""

    @abstractmethod
    def step(self, sample: PhysicsSample) -> None:
        """One physics step passes."""

    @abstractmethod
    def read(self) -> Mapping[str, np.ndarray]:
        """What the instrument shows now, channel name -> (W, *shape)."""

    @abstractmethod
    def idle(self) -> Mapping[str, float]:
        """Level of each channel with electronics on and motors idle, as someone would read it off."""

    def settle(self) -> None:  # noqa: B027 - most have nothing slow
        """Bring slow hidden state (heat) to the steady state of the steps since the last reset or settle."""

    def describe(self) -> Mapping[str, Any]:
        """Its parameters, for the twin's hash and the calibration table."""
        return {}
