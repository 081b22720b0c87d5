"""What runs a policy in the world `hoist`. Replace it by the link to your machine.

As it stands: the robot hangs in the air, so that only its joints move, and every number is made up. With target q*,

    J q̈ = clip(kp (q* − q) − kd q̇, ± limit) − friction q̇

No trunk moves, so the speed that it reports is the one that was commanded.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from hts.contracts import Instrument, PhysicsSample, Robot
from hts.errors import WorldError
from hts.policies.deploy import DeployedPolicy

MOVING = {"joint_position", "joint_velocity", "joint_torque", "joint_target", "command", "base_velocity"}
STILL = {"angular_velocity", "projected_gravity", "foot_force"}
GIVEN = MOVING | STILL
"""Sim channels that it gives."""


class Machine:
    """One robot and its sensors; both go on from one policy to the next."""

    def __init__(
        self,
        robot: Robot,
        sensors: Mapping[str, Instrument],
        inertia: float,
        friction: float,
        random: np.random.Generator,
    ) -> None:
        self.spec, self.sensors, self.inertia, self.friction = robot.spec, sensors, inertia, friction
        self.shapes = {name: channel.shape for name, channel in robot.channels().items()}
        self.position, self.velocity = np.array(self.spec.default_pose), np.zeros(self.spec.num_joints)
        self.torque, self.time = np.zeros(self.spec.num_joints), 0.0
        for sensor in sensors.values():
            sensor.reset(1, random)

    def walk(self, policy: DeployedPolicy, commands: np.ndarray) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        """Clock (T,), s, and channels (T, ...), as a robot would log them. commands: (T, 3) m/s, m/s, rad/s."""
        times, rows = [], []
        for command in commands:
            row = {name: np.zeros(shape) for name, shape in self.shapes.items()}
            row |= {"projected_gravity": np.array([0.0, 0.0, -1.0]), "command": command}
            row |= {"base_velocity": np.array([command[0], command[1], 0.0]), "angular_velocity": np.zeros(3)}
            row |= {"joint_position": self.position, "joint_velocity": self.velocity, "joint_torque": self.torque}
            try:
                (target,) = policy.targets({name: value[None] for name, value in row.items()})
            except KeyError as error:
                raise WorldError(f"The policy observes {error}, which this world does not give.") from error
            row["joint_target"] = target
            for sensor in self.sensors.values():
                row |= {name: value[0] for name, value in sensor.read().items()}
            rows.append(row)
            times.append(self.time)
            for _ in range(self.spec.substeps):
                self._step(target)
            self.time += 1.0 / self.spec.control_rate_hz
        return np.array(times), {name: np.stack([row[name] for row in rows]) for name in rows[0]} if rows else {}

    def _step(self, target: np.ndarray) -> None:
        """One step of physics, and of every sensor."""
        spec, dt = self.spec, self.spec.physics_dt
        limit = np.array(spec.torque_limit)
        wanted = np.array(spec.kp) * (target - self.position) - np.array(spec.kd) * self.velocity
        self.torque = np.clip(wanted, -limit, limit)
        self.velocity = self.velocity + dt * (self.torque - self.friction * self.velocity) / self.inertia
        self.position = self.position + dt * self.velocity
        in_the_air = np.zeros((1, len(spec.foot_sites)))
        sample = PhysicsSample(self.torque[None], self.velocity[None], in_the_air, in_the_air, in_the_air, dt)
        for sensor in self.sensors.values():
            sensor.step(sample)
