"""The world `known`: no physics, made-up recordings, and an answer that is known before.

Every policy but the reference costs `saving` less than it: of what a real channel shows above its idle level, exactly
that share is missing in the policy's blocks. Both roles get the same made-up walk, so the ratio is exact and not only
likely. They may walk slower than they are told (`pace`). Each sample of a real channel follows the robot's first joint
channels, so that a model can be fitted to it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import Field

from hts.channels import Channel
from hts.config import Config, ScheduleConfig
from hts.contracts import FollowVelocity, HoldSpeed, Objective, Robot, World, WorldContext
from hts.errors import UnfitWorldError
from hts.recordings.recording import Recording, Series
from hts.worlds.base import ORDER, commands, file_hash, request_id, seed_sequence


class Settings(Config):
    """Settings of the world `known`: `--set world.saving=0.1`."""

    saving: float = Field(0.2, lt=1, description="share that a policy saves against the reference, 1")
    level: float = Field(10.0, gt=0, description="mean of a real channel above its idle level, reference, its unit")
    swing: float = Field(0.3, ge=0, lt=1, description="how far it swings with the joints, share of `level`, 1")
    pace: float = Field(1.0, gt=0, description="speed of every policy but the reference, share of its command, 1")
    block_seconds: float = Field(12.0, gt=0, description="length of each of the four blocks of a head-to-head, s")


class KnownWorld(World):
    """Answers at once. The same request gets the same recordings."""

    name = "known"
    simulated = True

    def __init__(
        self,
        robot: Robot,
        objectives: Sequence[Objective],
        idle: Mapping[str, float],
        extra: Sequence[Channel] = (),
        settings: Settings | None = None,
        seed: int = 0,
    ) -> None:
        """idle: level per real channel, in its unit; extra: real channels beside those of the objectives. A saving
        lowers those that have an idle level."""
        self.robot, self.settings, self.seed = robot, settings or Settings(), seed
        self._idle = dict(idle)
        self._hold: HoldSpeed | None = None
        measured = (channel for objective in objectives for channel in objective.real_channels)
        self.real = {channel.name: channel for channel in (*extra, *measured)}

    def idle(self) -> Mapping[str, float]:
        return dict(self._idle)

    def check(self) -> None:
        if not isinstance(self.robot.task(), FollowVelocity):
            raise UnfitWorldError(
                f"World 'known' makes up walks at commanded velocities; robot '{self.robot.spec.name}' has another "
                "task. Try it in a world of its own."
            )

    def collect(self, policies: Sequence[Path], schedule: ScheduleConfig) -> list[Recording]:
        request = request_id("collect", self.seed, [file_hash(policy) for policy in policies], schedule.model_dump())
        return [
            self._recording(policy, schedule, request_id(request, number), 0, "collection", 1.0, number)
            for number, policy in enumerate(policies)
        ]

    def hold_speed(self, hold: HoldSpeed | None) -> bool:
        """Whoever walks slower gets as much more of a command, at once; nothing is walked for it."""
        self._hold = hold if self.robot.task().can_hold else None
        return self._hold is not None

    def head_to_head(self, policy: Path, reference: Path, speeds: Sequence[float]) -> list[Recording]:
        return self._head_to_head(policy, reference, speeds, self.settings.block_seconds)

    def head_to_heads_in_session(
        self, policies: Sequence[Path], reference: Path, speeds: Sequence[float], block_seconds: float | None
    ) -> list[list[Recording]]:
        seconds = block_seconds or self.settings.block_seconds
        return [self._head_to_head(policy, reference, speeds, seconds) for policy in policies]

    def _head_to_head(self, policy: Path, reference: Path, speeds: Sequence[float], seconds: float) -> list[Recording]:
        factor, pace = {"reference": 1.0, "policy": 1.0 - self.settings.saving}, {"policy": self.settings.pace}
        if file_hash(policy) == file_hash(reference):
            factor["policy"] = pace["policy"] = 1.0
        holding = [self._hold.named()] if self._hold is not None else []
        request = request_id("head to head", self.seed, file_hash(policy), file_hash(reference), *holding)
        paths = {"policy": policy, "reference": reference}
        recordings = []
        for speed in speeds:
            session = request_id(request, float(speed))
            schedule = self.robot.task().schedule(float(speed), seconds)
            recordings += [
                self._recording(paths[role], schedule, session, block, role, factor[role], pace=pace.get(role, 1.0))
                for block, role in enumerate(ORDER)
            ]
        return recordings

    def _recording(
        self,
        policy: Path,
        schedule: ScheduleConfig,
        session: str,
        block: int,
        role: str,
        factor: float,
        walk: int = 0,
        pace: float = 1.0,
    ) -> Recording:
        from hts.policies.deploy import DeployedPolicy

        spec, rng = self.robot.spec, np.random.default_rng(seed_sequence(self.seed, "0", walk))
        commanded, notes = commands(schedule, spec.control_rate_hz), {}
        if self._hold is not None and role != "collection":
            asked = schedule.commands[0].vx
            (low, high), wanted = self._hold.within(asked), asked / pace
            commanded[:, 0] = held = min(max(wanted, low), high)
            notes = {"held_command": repr(held), "held_saturated": "false" if low < wanted < high else "true"}
        values = {
            name: rng.standard_normal((len(commanded), *channel.shape))
            for name, channel in self.robot.channels().items()
        }
        values |= {
            "base_velocity": np.column_stack([pace * commanded[:, 0], np.zeros((len(commanded), 2))]),
            "projected_gravity": np.tile([0.0, 0.0, -1.0], (len(commanded), 1)),
            "command": commanded,
        }
        first = np.stack([v.mean(-1) for name, v in values.items() if name.startswith("joint_")] or [commanded[:, 0]])
        shape = 1.0 + self.settings.swing * np.tanh(first.sum(0))  # (T,)
        for name, channel in self.real.items():
            above = self.settings.level * shape * (factor if name in self._idle else 1.0)
            values[name] = np.broadcast_to(
                (self._idle.get(name, 0.0) + above).reshape(-1, *(1 for _ in channel.shape)),
                (len(commanded), *channel.shape),
            )
        known = {**self.robot.channels(), **self.real}
        length = len(commanded) / spec.control_rate_hz
        return Recording(
            robot=spec.name,
            world=self.name,
            policy_hash=DeployedPolicy(Path(policy)).card.policy_hash,
            iteration=0,
            joint_names=spec.joint_names,
            kp=spec.kp,
            kd=spec.kd,
            rate_hz=spec.control_rate_hz,
            schedule=schedule,
            idle=self._idle,
            clock="simulated",
            time=block * length + np.arange(len(commanded)) / spec.control_rate_hz,
            channels={name: Series(known[name], array) for name, array in values.items() if name in known},
            mass_kg=10.0,
            session=session,
            block=block,
            role=role,
            notes=notes,
        )


def make_known(settings: Mapping[str, Any], context: WorldContext) -> KnownWorld:
    """The world `known` for the robot and the objectives of a run, found in the registry."""
    from hts.plugins import load

    registry = context.registry or load()
    robot = registry.make_robot(context.robot, context.robot_settings)
    objectives = [registry.make_objective(name, given) for name, given in context.objectives.items()]
    idle: dict[str, float] = {}
    extra: list[Channel] = []
    for objective in objectives:
        if objective.instrument is None:
            idle[objective.target.name] = 1.0
        else:
            instrument = registry.make_instrument(objective.instrument, {}, robot)
            instrument.reset(1, np.random.default_rng(0))
            extra += instrument.channels
            idle |= instrument.idle()
    return KnownWorld(robot, objectives, idle, extra, Settings(**settings), context.seed)
