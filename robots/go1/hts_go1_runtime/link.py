"""The way to a robot: what it tells and what it is told. A link to another machine is a class with these methods.

| here | Go1, unitree_legged_sdk (`LowState`, `LowCmd`) | Go2, unitree_sdk2 (`unitree_go::msg::dds_`) |
|---|---|---|
| stamp | tick, ms | tick, ms |
| q, dq | motorState[i].q, .dq | motor_state[i].q, .dq |
| tau | motorState[i].tauEst, from motor current | motor_state[i].tau_est |
| temperature | motorState[i].temperature, int8 degC | motor_state[i].temperature, degC |
| quaternion, gyro, acc | imu.quaternion (w, x, y, z), .gyroscope, .accelerometer | imu_state, same names |
| foot_force | footForce[4], raw air-bag sensor, drifts | foot_force[4], raw |
| current | bms.current, int32 mA, negative discharges (assumed from Go2): -0.001 x | bms_state.current, mA |
| voltage | sum of bms.cell_vol, mV: 0.001 x | power_v, or sum of bms_state.cell_vol |
| charge | bms.SOC, % | bms_state.soc, % |
| velocity | not the robot's: motion capture or a camera, in the trunk frame | the same |
| Command.q, kp, kd | motorCmd[i].q, .Kp, .Kd with mode 0x0A, dq = 0, tau = 0 | motor_cmd[i].q, .kp, .kd with mode 1 |

Motors 0 to 11 of both are FR, FL, RR, RL, in each hip, thigh, calf: the order used here. Firmware expects a command
about every 2 ms (500 Hz): a link to a real robot repeats the last command from a thread of its own, and sends the
damping command by itself, and nothing else until a new session greets it, if it has not heard from the runtime for
100 ms. All fields of the battery can read 0 while the process that reads it is down, and so can the IMU's quaternion:
the runtime refuses to start then.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field

import numpy as np

from hts_go1_runtime.machine import DAMPING_KD

J = 12


@dataclass(frozen=True, slots=True)
class State:
    """One state of the robot. Arrays float64: q rad, dq rad/s, tau N*m, temperature degC (12,); quaternion (w, x, y, z)
    trunk to world; gyro rad/s, acc m/s2 (3,), trunk frame; foot_force (4,); velocity m/s (3,), trunk frame; current A,
    positive when discharging; voltage V; charge %. What the link has not is NaN.

    sequence: of the sender; stamp: its clock, s; received: this computer's clock, s.
    """

    sequence: int
    stamp: float
    received: float
    q: np.ndarray
    dq: np.ndarray
    tau: np.ndarray
    quaternion: np.ndarray
    gyro: np.ndarray
    acc: np.ndarray
    foot_force: np.ndarray
    velocity: np.ndarray
    current: float
    voltage: float
    charge: float
    temperature: np.ndarray

    @property
    def gravity(self) -> np.ndarray:
        """Unit vector of gravity in the trunk frame, (3,)."""
        w, x, y, z = self.quaternion
        return -np.array([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)])

    @property
    def heading(self) -> float:
        """Direction of the trunk's x axis seen from above, rad."""
        w, x, y, z = self.quaternion
        return float(np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)))


@dataclass(frozen=True, slots=True)
class Command:
    """Joint targets q rad with gains kp N*m/rad and kd N*m*s/rad, (12,) each."""

    q: np.ndarray
    kp: np.ndarray
    kd: np.ndarray


NOTHING = Command(np.zeros(J), np.zeros(J), np.zeros(J))
"""Motors idle."""
DAMPING = Command(np.zeros(J), np.zeros(J), np.full(J, DAMPING_KD))
"""The safe command: no position is held, motion is braked."""


@dataclass
class Counts:
    """What a link has seen. lost: numbers that never came; late: overtaken by a later state, dropped; broken: packets
    whose checksum was wrong."""

    received: int = 0
    lost: int = 0
    late: int = 0
    broken: int = 0
    sent: int = 0
    extra: dict[str, int] = field(default_factory=dict)


class Link(ABC):
    """To one robot. Every time is `now()`'s."""

    simulated: bool = False
    """Whether the clock is a simulation's, which waits for this computer."""
    counts: Counts

    @abstractmethod
    def now(self) -> float:
        """A clock that never goes back, s."""

    @abstractmethod
    def wait(self, until: float) -> list[State]:
        """New states, oldest first, as soon as there are any; none if nothing came for 4 ms, or until then."""

    @abstractmethod
    def send(self, command: Command) -> None:
        """Send now. May be called from another thread than `wait`. An OSError stops the robot as a lost link."""

    def hello(self) -> None:  # noqa: B027 - most robots talk unasked
        """Ask a far side that says nothing to begin."""

    @abstractmethod
    def close(self) -> None:
        """Let go of the line."""
