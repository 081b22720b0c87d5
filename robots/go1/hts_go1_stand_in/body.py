"""One simulated robot as its low-level computer shows it: 250 states a second, targets with gains in."""

from __future__ import annotations

from typing import Any

import numpy as np

from hts import plugins
from hts.testing.twin import (
    Batch,
    TwinSettings,
    maker,
    request_id,
    resolved_settings,
    seed_sequence,
)
from hts_go1_runtime.link import DAMPING, Command, State

STATE_SECONDS = 0.004
PER_READING = 5  # states between two readings of the pack's monitor, which is slow
PATIENCE = 0.1  # s without a command until the robot damps itself: five lost in a row (two, at 2 %, are one in 50 s)
JUMP = 1.0  # m
FALLEN_TILT = -0.5  # projected gravity z: 60 degrees


class Body:
    """A robot on a stool until its first real command: motors without gains, legs as they hang, idle to be measured.

    reality: name or file, None: the twin of the settings; objectives: whose instruments it carries; seed: of everything
    random in it.
    """

    def __init__(self, reality: str | None, objectives: list[str], seed: int) -> None:
        registry = plugins.load()
        robot = registry.make_robot("go1", {})
        settings = resolved_settings(TwinSettings.model_validate({"reality": reality} if reality else {}), "go1")
        instruments = maker(registry, robot, {name: {} for name in objectives}, settings)()
        self._batch = Batch(robot, settings, instruments, 1, seed_sequence(seed, request_id("stand-in", seed)))
        self._body, self._instruments = self._batch.body, tuple(instruments.values())
        self._steps = round(STATE_SECONDS / settings.dynamics.physics_dt)
        self.mass_kg = self._batch.mass_kg
        self._on_stool, self._damped = True, False
        self._gains: Command | None = None
        self._target: np.ndarray | None = None
        self._shown: dict[str, Any] = {}
        self._heard: float | None = None  # when the session's newest command came
        self._count, self._down = 0, False
        self._there, self._entered = np.zeros((2, 2))
        self.clock, self.falls = 0.0, 0

    def command(self, command: Command) -> None:
        """Targets with gains; act after the robot's own delay. A robot that damped itself obeys nobody until it is
        greeted: it would spring up from wherever it has sunk to."""
        if self._damped:
            return
        self._heard = self.clock
        if self._on_stool and not command.kp.any():
            self._set_gains(command)
            return
        self._on_stool = False
        self._set_gains(command)
        self._target = command.q[None]

    def greet(self) -> None:
        """Another runtime has come. Its commands count; until the first, the gains stay as they are."""
        self._heard, self._damped = None, False

    def advance(self) -> None:
        """STATE_SECONDS pass."""
        if not self._on_stool and self._heard is not None and self.clock - self._heard > PATIENCE:
            self._set_gains(DAMPING)
            self._damped = True
        self._batch.supply()
        if self._on_stool:
            self._body.stand(np.ones(1, dtype=bool))
        self._body.advance(self._target, self._steps, self._instruments)
        self._target = None
        self.clock += STATE_SECONDS

    def state(self, sequence: int) -> State:
        """What the sensors show now."""
        seen = self._batch.sensors.read(STATE_SECONDS)
        if self._count % PER_READING == 0:
            for instrument in self._instruments:
                self._shown.update(instrument.read())
        self._count += 1
        gravity = seen["projected_gravity"][0]
        fallen = bool(gravity[2] > FALLEN_TILT)
        self.falls += fallen and not self._down
        self._down = fallen
        shown = {name: values[0] for name, values in self._shown.items()}
        return State(
            sequence,
            self.clock,
            0.0,
            q=seen["joint_position"][0],
            dq=seen["joint_velocity"][0],
            tau=seen["joint_torque"][0],
            quaternion=quaternion_of(gravity, float(self._body.heading()[0])),
            gyro=seen["angular_velocity"][0],
            acc=-9.81 * gravity,
            foot_force=seen["foot_force"][0],
            velocity=seen["base_velocity"][0],
            current=float(shown.get("battery_current", np.nan)),
            voltage=float(shown.get("battery_voltage", np.nan)),
            charge=float(shown.get("state_of_charge", np.nan)),
            temperature=np.asarray(shown.get("motor_temperature", np.full(12, np.nan)), float),
        )

    def place(self) -> tuple[float, float, float]:
        """Where it is: x m, y m, heading rad, which no sensor of it shows. Asked ten times a second: where the floor is
        a piece that repeats itself, it leaves it at one end and enters it at the other, which is no step."""
        there = self._body.qpos[0, :2].copy()
        self._entered += np.where(np.abs(there - self._there) > JUMP, self._there - there, 0.0)
        self._there = there
        x, y = there + self._entered
        return float(x), float(y), float(self._body.heading()[0])

    def close(self) -> None:
        """Let go of the engine."""
        self._batch.close()

    def _set_gains(self, command: Command) -> None:
        known = self._gains
        if known is None or (known.kp != command.kp).any() or (known.kd != command.kd).any():
            self._body.set_gains(command.kp, command.kd)
            self._gains = command


def quaternion_of(gravity: np.ndarray, heading: float) -> np.ndarray:
    """(w, x, y, z) of the trunk whose frame sees gravity (3,) so and whose x axis points to heading, rad."""
    pitch = np.arcsin(np.clip(gravity[0], -1, 1)) / 2
    roll, yaw = np.arctan2(-gravity[1], -gravity[2]) / 2, heading / 2
    (sr, sp, sy), (cr, cp, cy) = np.sin([roll, pitch, yaw]), np.cos([roll, pitch, yaw])
    return np.array(
        [
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        ]
    )
