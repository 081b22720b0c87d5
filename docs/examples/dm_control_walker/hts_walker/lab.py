"""The world `walker_lab`: reality for a walker that has none.

The suite's walker with other numbers (heavier, more damping) and a power meter. It gets exported
policies and gives recordings. Nothing of it is imported by the robot or by the env that policies are trained in.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from pydantic import Field

from hts.config import Config, ScheduleConfig
from hts.contracts import World, WorldContext
from hts.errors import WorldError
from hts.policies.deploy import DeployedPolicy
from hts.recordings.recording import Recording, Series
from hts_walker.channels import channel_values
from hts_walker.objective import POWER
from hts_walker.robot import CHANNELS, OBSERVATION, SPEC, WalkForward

RATE = SPEC.control_rate_hz
ORDER = ("reference", "policy", "policy", "reference")  # A-B-B-A cancels a drift that is linear in time


class Settings(Config):
    """Made-up numbers, none of them measured on anything. `--set world.torso_mass=1.2`"""

    torso_mass: float = Field(1.2, gt=0, description="factor on the torso's mass, 1")
    damping: float = Field(2.0, gt=0, description="factor on joint damping, 1")
    idle_watts: float = Field(15.0, ge=0, description="what the electronics take, W")
    copper: float = Field(0.01, ge=0, description="heat per squared torque, W/(N*m)^2")
    meter_seconds: float = Field(0.1, gt=0, description="time constant of the meter, s")
    warmup_seconds: float = Field(6.0, ge=0, description="walked before a recording begins, s")
    block_seconds: float = Field(20.0, gt=0, description="of each of the four blocks of a head-to-head, s")


class WalkerLab(World):
    """One walker and one meter."""

    name = "walker_lab"
    simulated = True

    def __init__(self, settings: Settings, context: WorldContext) -> None:
        if context.robot != SPEC.name:
            raise WorldError(f"World 'walker_lab' has a walker and no '{context.robot}': use --robot {SPEC.name}.")
        self.settings, self.seed = settings, context.seed

    def idle(self) -> Mapping[str, float]:
        return {POWER.name: self.settings.idle_watts}

    def collect(self, policies: Sequence[Path], schedule: ScheduleConfig) -> list[Recording]:
        recordings = []
        for number, path in enumerate(policies):
            machine = Machine(self.settings, self.seed + number)
            policy = machine.load(path)
            machine.walk(policy, self.settings.warmup_seconds)
            recordings.append(self._recording(machine, policy, schedule, f"collection-{number}"))
        return recordings

    def head_to_head(self, policy: Path, reference: Path, speeds: Sequence[float]) -> list[Recording]:
        machine = Machine(self.settings, self.seed)
        policies = {"policy": machine.load(policy), "reference": machine.load(reference)}
        machine.walk(policies["reference"], self.settings.warmup_seconds)
        recordings = []
        for speed in speeds:
            schedule = WalkForward().schedule(speed, self.settings.block_seconds)
            for block, role in enumerate(ORDER):
                session = f"{policies['policy'].card.policy_hash[:12]}-{speed:g}"
                recordings.append(self._recording(machine, policies[role], schedule, session, role, block))
        return recordings

    def head_to_head_seconds(self) -> float:
        return self.settings.warmup_seconds + len(ORDER) * self.settings.block_seconds

    def cost(self, robot_seconds: float) -> Mapping[str, float]:
        return {"robot_minutes": robot_seconds / 60.0, "wall_seconds": robot_seconds * RATE / 1000.0}

    def _recording(self, machine, policy, schedule, session, role="collection", block=0) -> Recording:
        time, values = machine.walk(policy, schedule.seconds)
        channels = {channel.name: channel for channel in (*CHANNELS, POWER)}
        return Recording(
            robot=SPEC.name,
            world=self.name,
            policy_hash=policy.card.policy_hash,
            iteration=0,
            joint_names=SPEC.joint_names,
            kp=SPEC.kp,
            kd=SPEC.kd,
            rate_hz=RATE,
            schedule=schedule,
            idle=self.idle(),
            clock="simulated",
            time=time,
            channels={n: Series(channels[n], values[n]) for n in channels},
            mass_kg=machine.mass,
            session=session,
            role=role,
            block=block,
        )


class Machine:
    """The walker in the lab, and its meter; both go on from one policy to the next."""

    def __init__(self, settings: Settings, seed: int) -> None:
        from dm_control import suite

        self.settings, self.seed, self.time = settings, seed, 0.0
        self.env = suite.load("walker", "walk", task_kwargs={"random": seed, "time_limit": float("inf")})
        self.env.reset()
        model = self.env.physics.model
        model.body_mass[model.name2id("torso", "body")] *= settings.torso_mass
        model.dof_damping[3:] *= settings.damping
        self.mass = float(model.body_mass.sum())
        self.shown = settings.idle_watts
        # Somebody puts it on its feet; the suite itself would throw it on the floor.
        with self.env.physics.reset_context():
            self.env.physics.named.data.qpos[["right_knee", "left_knee"]] = -0.1

    def load(self, path: Path) -> DeployedPolicy:
        policy = DeployedPolicy(path)
        policy.start(1, self.seed)
        return policy

    def walk(self, policy: DeployedPolicy, seconds: float) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        """Clock (T,), s, and channels (T, ...), as a robot would log them."""
        physics, task = self.env.physics, self.env.task
        rows, times = [], []
        for _ in range(round(seconds * RATE)):
            seen = {name: np.atleast_1d(value) for name, value in task.get_observation(physics).items()}
            readings = {name: seen[name][None] for name, _ in OBSERVATION}
            control = policy.action(readings)[0].clip(-1.0, 1.0)
            physics.set_control(control)
            physics.step(SPEC.substeps)
            self.time += 1.0 / RATE
            seen = {name: np.atleast_1d(value) for name, value in task.get_observation(physics).items()}
            row = channel_values(seen, control, np.stack)
            row[POWER.name] = self._meter(row["joint_torque"], row["joint_velocity"])
            rows.append(row)
            times.append(self.time)
        return np.array(times), {name: np.stack([row[name] for row in rows]) for name in rows[0]} if rows else {}

    def _meter(self, torque: np.ndarray, joint_velocity: np.ndarray) -> float:
        """Work that motors do (braking gives nothing back) and heat in their windings, shown late, W."""
        now = (torque * joint_velocity).clip(min=0.0).sum() + self.settings.copper * (torque**2).sum()
        blend = min(1.0, 1.0 / (RATE * self.settings.meter_seconds))
        self.shown += (self.settings.idle_watts + now - self.shown) * blend
        return self.shown
