"""The world `hoist`: policies come in, recordings go out, nothing else.

What runs a policy is in `machine`: replace it by the link to your robot, your test rig or another simulator. What is
here may stay: which policy walks when, and what a recording says.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from pydantic import Field

from hts.config import Config, ScheduleConfig
from hts.contracts import FollowVelocity, World, WorldContext
from hts.errors import UnfitWorldError
from hts.plugins import load
from hts.policies.deploy import DeployedPolicy
from hts.recordings import Recording, Series
from hts.testing.examples.world.machine import GIVEN, Machine

ORDER = ("reference", "policy", "policy", "reference")  # A-B-B-A cancels a drift that is linear in time


class Settings(Config):
    """Settings of the world: `--set world.block_seconds=40`. A key that is not here is refused."""

    inertia: float = Field(0.02, gt=0, description="of each joint, kg·m²; made up")
    friction: float = Field(0.05, ge=0, description="of each joint, N·m·s/rad; made up")
    warmup_seconds: float = Field(1.0, ge=0, description="run before a recording begins, s")
    block_seconds: float = Field(8.0, gt=0, description="of each of the four blocks of a head-to-head, s")


class Hoist(World):
    """One machine at a time, with the sensors that the run's objectives name."""

    name = "hoist"
    simulated = True  # False where a machine moves

    def __init__(self, settings: Settings, context: WorldContext) -> None:
        """Making a world writes and starts nothing; every command makes one to see whether its settings are right."""
        registry = context.registry or load()
        self.settings, self.seed = settings, context.seed
        self.robot = registry.make_robot(context.robot, context.robot_settings)
        if not isinstance(self.robot.task(), FollowVelocity):
            raise UnfitWorldError(
                f"World 'hoist' commands velocities, and robot '{context.robot}' has another task. Command its "
                "set-points in Machine.walk, or use another world."
            )
        lacking = sorted(set(self.robot.channels()) - GIVEN)
        if lacking:
            raise UnfitWorldError(
                f"World 'hoist' does not measure '{lacking[0]}', a channel of robot '{context.robot}'. Add it to "
                "Machine.walk, or use another world."
            )
        self.sensors = {}
        for name, given in context.objectives.items():
            objective = registry.make_objective(name, given)
            if objective.instrument is None:
                raise UnfitWorldError(
                    f"World 'hoist' has no sensor of '{objective.target.name}' for objective '{name}', which names no "
                    "instrument. Read your own sensor in Machine.walk, or use --world field."
                )
            self.sensors[objective.instrument] = registry.make_instrument(objective.instrument, {}, self.robot)
        for sensor in self.sensors.values():
            sensor.reset(1, np.random.default_rng(self.seed))
        self.real = {channel.name: channel for sensor in self.sensors.values() for channel in sensor.channels}

    def idle(self) -> Mapping[str, float]:
        return {name: level for sensor in self.sensors.values() for name, level in sensor.idle().items()}

    def collect(self, policies: Sequence[Path], schedule: ScheduleConfig) -> list[Recording]:
        return [
            self._recording(self._machine(number), DeployedPolicy(path), schedule, f"collection-{number}", seed=number)
            for number, path in enumerate(policies)
        ]

    def head_to_head(self, policy: Path, reference: Path, speeds: Sequence[float]) -> list[Recording]:
        both = {"policy": DeployedPolicy(policy), "reference": DeployedPolicy(reference)}
        pair = "-".join(one.card.policy_hash[:12] for one in both.values())
        recordings = []
        for number, speed in enumerate(speeds):
            machine = self._machine(number)  # one machine a speed, which goes on from block to block
            schedule = self.robot.task().schedule(speed, self.settings.block_seconds)
            for block, role in enumerate(ORDER):
                recordings.append(self._recording(machine, both[role], schedule, f"{pair}-{speed:g}", role, block))
        return recordings

    def head_to_head_seconds(self) -> float:
        return self.settings.warmup_seconds + len(ORDER) * self.settings.block_seconds

    def cost(self, robot_seconds: float) -> Mapping[str, float]:
        return {"robot_minutes": robot_seconds / 60.0, "wall_seconds": 0.1 * robot_seconds}

    def _machine(self, number: int) -> Machine:
        """The same question gets the same answer: randomness comes from the run's seed and the request."""
        random = np.random.default_rng([self.seed, number])
        return Machine(self.robot, self.sensors, self.settings.inertia, self.settings.friction, random)

    def _recording(self, machine, policy, schedule, session, role="collection", block=0, seed=0) -> Recording:
        policy.start(1, seed)
        commands, rate = schedule.commands, self.robot.spec.control_rate_hz
        rows = [np.tile([one.vx, one.vy, one.yaw_rate], (round(one.seconds * rate), 1)) for one in commands]
        if block == 0 and self.settings.warmup_seconds:
            machine.walk(policy, np.tile(rows[0][0], (round(self.settings.warmup_seconds * rate), 1)))
        time, values = machine.walk(policy, np.concatenate(rows))
        known = {**self.robot.channels(), **self.real}
        spec = self.robot.spec
        return Recording(
            robot=spec.name,
            world=self.name,
            policy_hash=policy.card.policy_hash,
            iteration=0,
            joint_names=spec.joint_names,
            kp=spec.kp,
            kd=spec.kd,
            rate_hz=rate,
            schedule=schedule,
            idle=self.idle(),
            clock="simulated",
            time=time,
            channels={name: Series(known[name], values[name]) for name in known},
            mass_kg=10.0,  # weigh yours
            session=session,
            block=block,
            role=role,
        )
