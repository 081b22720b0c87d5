"""Runs sessions on a batch of twins, side by side, and makes recordings of what a real robot would give."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hts.channels import Channel
from hts.contracts import Instrument, Robot
from hts.errors import PolicyError
from hts.evaluation.segments import FELL_AT
from hts.recordings.recording import Recording, Series
from hts.worlds.base import Operator, commands
from hts.worlds.twin.dynamics import Dynamics
from hts.worlds.twin.ground import Conditions
from hts.worlds.twin.model import Machine, build
from hts.worlds.twin.parameters import TwinSettings
from hts.worlds.twin.programme import Block, Session
from hts.worlds.twin.sensors import Sensors
from hts.worlds.twin.trimming import HeldCommand, Trimming

FALLEN_TILT = -0.5  # projected gravity z: 60 degrees
FALLEN_HEIGHT, FALLEN_SECONDS = 0.4, 0.5  # trunk below this share of its height in the default pose, for so long

Progress = Callable[[float], None]


class Standing:
    """The robot's own stand mode for W robots: holds the default pose, with the torque of standing fed forward."""

    def __init__(self, machine: Machine) -> None:
        self._targets = np.array(machine.spec.default_pose) + machine.standing_torque / np.array(machine.spec.kp)

    def start(self, num: int, seed: int | None = None) -> None:
        self._num = num

    def reset(self, mask: np.ndarray) -> None:
        """There is nothing to forget."""

    def targets(self, readings: Mapping[str, np.ndarray]) -> np.ndarray:
        """Joint targets (W, J), rad."""
        return np.tile(self._targets, (self._num, 1))


class Batch:
    """W robots of one make, on which W sessions run side by side. Closes with `close`."""

    def __init__(
        self,
        robot: Robot,
        settings: TwinSettings,
        instruments: Mapping[str, Instrument],
        num_worlds: int,
        seeds: np.random.SeedSequence,
    ) -> None:
        self.robot, self.spec, self.settings, self.instruments = robot, robot.spec, settings, instruments
        self.machine = build(robot, settings.dynamics)
        sensor_seed, policy_seed, *instrument_seeds = seeds.spawn(2 + len(instruments))
        session_random, body_random = (np.random.default_rng(seed) for seed in seeds.spawn(2))
        self.conditions = Conditions.drawn(settings.sessions, num_worlds, session_random)
        self.body = Dynamics(self.machine, settings.dynamics, num_worlds, self.conditions, body_random)
        self._policy_random = np.random.default_rng(policy_seed)  # of policies that are run with exploration noise
        self.sensors = Sensors(
            settings.sensors, self.body, settings.dynamics.machine, np.random.default_rng(sensor_seed)
        )
        for instrument, seed in zip(instruments.values(), instrument_seeds, strict=True):
            instrument.reset(num_worlds, np.random.default_rng(seed))
        self.operator = Operator(num_worlds, self.conditions.heading_gain, self.conditions.heading_offset)
        self._sags = settings.dynamics.structure.torque_follows_supply
        self.notes = self._noted(num_worlds)
        self.period = 1 / self.spec.control_rate_hz
        self.steps = round(self.period / settings.dynamics.physics_dt)
        self._low_seconds = np.zeros(num_worlds)
        self._ticks = 0  # control steps since switching on
        self._unrecorded = 0  # of them since the last recorded block
        self._held: list[dict[tuple[str | None, float], HeldCommand]] = [{} for _ in range(num_worlds)]
        step = settings.sensors.scale_resolution
        self.mass_kg = round(round(self.machine.total_mass / step) * step, 4)

    def run(
        self, sessions: Sequence[Session], world: str, progress: Progress = lambda share: None
    ) -> list[list[Recording]]:
        """Recordings of each session, in the order of its blocks. Sessions must have blocks of the same lengths."""
        recordings: list[list[Recording]] = [[] for _ in sessions]
        done, total = 0.0, sessions[0].seconds
        for held, session in zip(self._held, sessions, strict=True):
            held.update({(one.policy, one.asked): HeldCommand(one.command, one.saturated) for one in session.kept})
        for blocks in zip(*(session.blocks for session in sessions), strict=True):
            share = blocks[0].schedule.seconds / total
            trimming = self._trimming(blocks, sessions)
            recorder = self._run_block(blocks, trimming, progress, done, share)
            done += share
            if blocks[0].settle:
                for instrument in self.instruments.values():
                    instrument.settle()
            for number, (block, session) in enumerate(zip(blocks, sessions, strict=True)):
                if block.recorded:
                    name = block.session or session.id
                    recordings[number].append(recorder.recording(number, block, name, self, world))
            self._unrecorded = 0 if blocks[0].recorded else self._unrecorded + recorder.length
            if trimming is not None:
                for block, held, found in zip(blocks, self._held, trimming.found(), strict=True):
                    held[_held_key(block)] = found
        return recordings

    def _trimming(self, blocks: Sequence[Block], sessions: Sequence[Session]) -> Trimming | None:
        """The outer loop of blocks that trim; None for others."""
        hold = sessions[0].hold
        if blocks[0].speed != "trim" or hold is None:
            return None
        asked = np.array([block.schedule.commands[0].vx for block in blocks])
        return Trimming(asked, dataclasses.replace(hold, seconds=blocks[0].schedule.seconds), self.period)

    def held_notes(self, number: int, block: Block) -> dict[str, str]:
        """What the recording of a block says about its held speed; nothing where it was not held."""
        if block.speed != "held":
            return {}
        found = self._held[number][_held_key(block)]
        return {
            "held_command": repr(found.command),
            "held_saturated": "true" if found.saturated else "false",
            "unrecorded_seconds": f"{self._unrecorded * self.period:g}",
        }

    def falls_before(self, number: int, block: Block) -> int:
        """Falls of a block's policy while it trimmed; asked once, so that no second block counts them again."""
        found = self._held[number].get(_held_key(block)) if block.speed == "held" else None
        if found is None:
            return 0
        self._held[number][_held_key(block)] = dataclasses.replace(found, falls=0)
        return found.falls

    def _run_block(
        self, blocks: Sequence[Block], trimming: Trimming | None, progress: Progress, done: float, share: float
    ) -> Recorder:
        """done, share: of the whole, for `progress`, when these blocks begin and by them."""
        commanded = np.stack([commands(block.schedule, self.spec.control_rate_hz) for block in blocks])  # (W, T, 3)
        for number, block in enumerate(blocks):
            if block.speed == "held":
                commanded[number, :, 0] = self._held[number][_held_key(block)].command
        policy_batch = PolicyBatch(
            self.machine, [block.policy for block in blocks], int(self._policy_random.integers(2**31))
        )
        self.body.set_gains(policy_batch.kp, policy_batch.kd)
        recorder = Recorder(self, commanded.shape[1], policy_batch)
        for step in range(commanded.shape[1]):
            readings = self.sensors.read(self.period)
            if trimming is not None:
                trimming.see(readings["base_velocity"][:, 0])
                commanded[:, step, 0] = trimming.command
            readings["command"] = self.operator.command(commanded[:, step], self.body.heading())
            readings["joint_target"] = policy_batch.targets(readings)
            for instrument in self.instruments.values():
                readings.update(instrument.read())
            fell = self._fallen(readings)
            recorder.write(step, self._ticks * self.period, readings, fell)
            if fell.any():  # picked up and set down again
                self.body.stand(fell)
                self.operator.forget(fell)
                self._low_seconds[fell] = 0
                policy_batch.reset(fell)
                if trimming is not None:
                    trimming.fell(fell)
                readings["joint_target"][fell] = self.spec.default_pose
            self.supply()
            self.body.advance(readings["joint_target"], self.steps, tuple(self.instruments.values()))
            self._ticks += 1
            if step % 50 == 0:
                progress(done + share * (step / commanded.shape[1]))
        return recorder

    def supply(self) -> None:
        """The voltage that the motors get now, from the instrument that simulates it, where torque depends on it."""
        for instrument in self.instruments.values() if self._sags else ():
            ratio = instrument.supply()
            if ratio is not None:
                self.body.set_supply(ratio)

    def _noted(self, num_worlds: int) -> list[dict[str, str]]:
        """What somebody notes of each robot's session at its start, as text."""
        noted: dict[str, np.ndarray] = {}
        for instrument in self.instruments.values():
            noted |= instrument.conditions()
        settings = self.settings
        which = {"reality": settings.reality, "reality_sha256": settings.reality_sha256} if settings.reality else {}
        rows = [{name: f"{values[number]:g}" for name, values in noted.items()} for number in range(num_worlds)]
        return [{**{name: str(value) for name, value in which.items()}, **row} for row in rows]

    def _fallen(self, readings: Mapping[str, np.ndarray]) -> np.ndarray:
        """Robots (W,) that lie on their side, have collapsed, or whose physics broke down."""
        low = self.body.qpos[:, 2] < FALLEN_HEIGHT * self.spec.base_height
        self._low_seconds = np.where(low, self._low_seconds + self.period, 0.0)
        collapsed = self._low_seconds > FALLEN_SECONDS
        return collapsed | (readings["projected_gravity"][:, 2] > FALLEN_TILT) | self.body.diverged()

    def close(self) -> None:
        self.body.close()


def _held_key(block: Block) -> tuple[str | None, float]:
    """A held command belongs to a policy at an asked speed."""
    return block.policy, block.schedule.commands[0].vx


class PolicyBatch:
    """The controllers of a block: robots with the same policy share one.
    hashes: of each robot's policy; kp, kd (W, J)."""

    def __init__(self, machine: Machine, policies: Sequence[str | None], seed: int = 0) -> None:
        self._machine, self._spec = machine, machine.spec
        self._members = {p: np.flatnonzero([q == p for q in policies]) for p in dict.fromkeys(policies)}
        self._controllers = {path: self._controller(path) for path in self._members}
        for path, worlds in self._members.items():
            self._controllers[path].start(len(worlds), seed)
        cards = [None if path is None else self._controllers[path].card for path in policies]
        self.hashes = [card.policy_hash if card else "" for card in cards]
        self.kp = np.array([card.kp if card else self._spec.kp for card in cards], dtype=float)
        self.kd = np.array([card.kd if card else self._spec.kd for card in cards], dtype=float)

    def targets(self, readings: Mapping[str, np.ndarray]) -> np.ndarray:
        """Joint targets of all robots (W, J), rad. Raises PolicyError for a policy that gives something not finite."""
        targets = np.empty_like(readings["joint_position"])
        for path, worlds in self._members.items():
            own = (
                readings if len(worlds) == len(targets) else {name: values[worlds] for name, values in readings.items()}
            )
            targets[worlds] = self._controllers[path].targets(own)
        if not np.isfinite(targets).all():
            bad = next(p for p, worlds in self._members.items() if not np.isfinite(targets[worlds]).all())
            raise PolicyError(
                f"{bad}: gives a joint target that is not a finite number. Nothing was recorded; export it again."
            )
        return targets

    def reset(self, mask: np.ndarray) -> None:
        """Forget the past of the robots of the mask (W,)."""
        for path, worlds in self._members.items():
            if mask[worlds].any():
                self._controllers[path].reset(mask[worlds])

    def _controller(self, path: str | None) -> Any:  # Standing, or DeployedPolicy, which alone has a card
        if path is None:
            return Standing(self._machine)
        from hts.policies.deploy import DeployedPolicy

        policy = DeployedPolicy(Path(path))
        if tuple(policy.card.joint_names) != tuple(self._spec.joint_names):
            raise PolicyError(f"{path}: made for robot '{policy.card.robot}', this twin is a '{self._spec.name}'.")
        return policy


class Recorder:
    """What is written down of W robots during a block of T control steps."""

    def __init__(self, batch: Batch, length: int, policy_batch: PolicyBatch) -> None:
        self.length, self._policies = length, policy_batch
        self.channels: dict[str, Channel] = dict(batch.robot.channels())
        for instrument in batch.instruments.values():
            self.channels |= {channel.name: channel for channel in instrument.channels}
        self._values: dict[str, np.ndarray] = {}
        self._time = np.empty(length)
        self._falls: list[list[float]] = [[] for _ in policy_batch.hashes]  # s after the first sample

    def write(self, step: int, time: float, readings: Mapping[str, np.ndarray], fell: np.ndarray) -> None:
        """One control step of all robots: channel -> (W, *shape)."""
        if not self._values:
            self._values = {
                name: np.empty((len(fell), self.length, *channel.shape), dtype=np.float32)
                for name, channel in self.channels.items()
                if name in readings
            }
        for name, values in self._values.items():
            values[:, step] = readings[name]
        self._time[step] = time
        for number in np.flatnonzero(fell):
            self._falls[number].append(time - float(self._time[0]))

    def recording(self, number: int, block: Block, session: str, batch: Batch, world: str) -> Recording:
        """The recording of one robot."""
        idle: dict[str, float] = {}
        for instrument in batch.instruments.values():
            idle |= instrument.idle()
        spec, falls = batch.spec, self._falls[number]
        counted = len(falls) + batch.falls_before(number, block)
        notes = {"unsteady_seconds": f"{batch.settings.unsteady_seconds:g}", "falls": str(counted)}
        notes |= {FELL_AT: ", ".join(f"{one:.6g}" for one in falls)} if falls else {}
        notes |= batch.held_notes(number, block)
        notes |= batch.notes[number]
        return Recording(
            robot=spec.name,
            world=world,
            policy_hash=self._policies.hashes[number],
            iteration=0,
            joint_names=spec.joint_names,
            kp=tuple(self._policies.kp[number].tolist()),
            kd=tuple(self._policies.kd[number].tolist()),
            rate_hz=spec.control_rate_hz,
            schedule=block.schedule,
            idle=idle,
            clock="simulated",
            time=self._time,
            channels={name: Series(self.channels[name], values[number]) for name, values in self._values.items()},
            mass_kg=batch.mass_kg,
            session=session,
            block=block.index,
            role=block.role,
            fell=bool(falls),
            notes=notes,
        )
