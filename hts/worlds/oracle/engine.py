"""A reality as an engine of the training env: the twin's own dynamics, drives, link, sensors and instruments."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import torch

from hts.contracts import Instrument, Robot
from hts.cores import available
from hts.errors import SimulationError
from hts.sim.conventions import TRUNK_TOUCH, sensor_groups
from hts.sim.engine import Engine
from hts.worlds.oracle.sessions import Sessions
from hts.worlds.twin.parameters import TwinSettings

TOGETHER = 32  # robots that share one thread's arrays at most; which ones share must not depend on the machine
READINGS = ("angular_velocity", "projected_gravity", "joint_position", "joint_velocity")


class RealityEngine(Engine):
    """P·N robots of a reality. Candidates share nothing: the robots of each draw from its own seed.

    `step` sends the joint targets of the control step; what becomes of them is the reality's affair. Beside the state,
    which no robot would give: readings, channel -> (W, ...), of the robots' own sensors; truth, channel -> (W,), of
    `Instrument.truth`; down (W, 3): direction of gravity over the floor; over (W,): sessions that end with this step.
    """

    def __init__(
        self,
        robot: Robot,
        settings: TwinSettings,
        instruments: Callable[[], dict[str, Instrument]],
        num_envs: int,
        seeds: Sequence[int],
        threads: int = 0,
    ) -> None:
        spec = robot.spec
        self.device = torch.device("cpu")
        self.num_worlds = len(seeds) * num_envs
        parts = [range(start, min(start + TOGETHER, num_envs)) for start in range(0, num_envs, TOGETHER)]
        self._rows: list[slice] = []
        self._sessions: list[Sessions] = []
        for candidate, seed in enumerate(seeds):
            for number, part in enumerate(parts):
                begin = candidate * num_envs + part.start
                self._rows.append(slice(begin, begin + len(part)))
                self._sessions.append(Sessions(robot, settings, instruments, len(part), (seed, number)))
        self._pool = ThreadPoolExecutor(threads or available(), "reality")
        machine = self._sessions[0].batch.machine
        self._joints = machine.joint_qpos
        address = [machine.model.sensor(f"twin_velocity_{i}").adr[0] for i in range(len(spec.foot_sites))]
        self._feet = np.concatenate([np.arange(start, start + 3) for start in address])
        joints, feet, groups = spec.num_joints, len(spec.foot_sites), sensor_groups(spec)
        names = {name: 3 if kind == "foot_velocity" else 1 for kind, group in groups.items() for name in group}
        names[TRUNK_TOUCH] = 1  # the twin's trunk has no sensor: a robot that lies has fallen by its height
        ends = np.cumsum([*names.values()]).tolist()
        self._slices = {name: slice(end - size, end) for (name, size), end in zip(names.items(), ends, strict=True)}
        worlds = self.num_worlds
        self.qpos, self.qvel = torch.zeros(worlds, 7 + joints), torch.zeros(worlds, 6 + joints)
        self.sensordata = torch.zeros(worlds, joints + 4 * feet + 1)
        self.diverged = torch.zeros(worlds, dtype=torch.bool)
        self.over = torch.zeros(worlds, dtype=torch.bool)
        self.down = torch.zeros(worlds, 3)
        first = self._sessions[0]
        self.readings = {name: torch.zeros(worlds, first.readings[name].shape[1]) for name in READINGS}
        self.truth = {name: torch.zeros(worlds) for name in first.truth}
        self.heading_gain, self.heading_offset = torch.ones(worlds), torch.zeros(worlds)
        for index in range(len(self._sessions)):
            self._met(index)
            self._see(index)

    def step(self, ctrl: torch.Tensor) -> None:
        """ctrl (substeps, W, J): joint targets, rad; the last ones are sent, the reality's link does the delaying."""
        targets = ctrl[-1].double().numpy()
        if not np.isfinite(targets).all():
            bad = np.flatnonzero(~np.isfinite(targets).all(axis=1))
            raise SimulationError(f"A non-finite joint target was sent to the reality in worlds {bad[:8].tolist()}.")

        def advance(index: int) -> None:
            self._sessions[index].step(targets[self._rows[index]])
            self._see(index)

        list(self._pool.map(advance, range(len(self._sessions))))

    def reset(self, mask: torch.Tensor, qpos: torch.Tensor, qvel: torch.Tensor) -> None:
        """Set robots down in the default pose, as somebody beside the track does; the rows are not read.

        Where sessions were over, all of their robots must be in the mask: they begin other ones.
        """
        for index, (rows, sessions) in enumerate(zip(self._rows, self._sessions, strict=True)):
            own = mask[rows].numpy()
            if not own.any():
                continue
            if sessions.over:
                assert own.all(), "a session goes on beside one that is over"
                sessions.renew()
                self._met(index)
            else:
                sessions.stand(own)
            self._see(index, own)

    def push(self, mask: torch.Tensor, velocity: torch.Tensor) -> None:
        raise SimulationError("Nobody pushes the robots of a reality: finetune.env.randomisation is off there.")

    def sensor(self, name: str) -> slice:
        return self._slices[name]

    def state_dict(self) -> dict[str, torch.Tensor]:
        raise SimulationError("A reality cannot be saved in mid-session.")

    def load_state_dict(self, state: Mapping[str, torch.Tensor]) -> None:
        raise SimulationError("A reality cannot be saved in mid-session.")

    def close(self) -> None:
        self._pool.shutdown()
        for sessions in self._sessions:
            sessions.close()

    def _met(self, index: int) -> None:
        """What stays as it is during a session."""
        rows, batch = self._rows[index], self._sessions[index].batch
        down = batch.body.down
        self.down[rows] = torch.tensor((0.0, 0.0, -1.0)) if down is None else torch.from_numpy(down).float()
        self.heading_gain[rows] = torch.from_numpy(batch.conditions.heading_gain).float()
        self.heading_offset[rows] = torch.from_numpy(batch.conditions.heading_offset).float()

    def _see(self, index: int, own: np.ndarray | None = None) -> None:
        """Copy what has become of the robots of some sessions, of all or of the mask (W,) of them."""
        chosen = slice(None) if own is None else own
        rows, sessions = self._rows[index], self._sessions[index]
        body = sessions.batch.body
        sensed = np.concatenate(
            (body.commanded_torque, body.foot_force, body.sensordata[:, self._feet], np.zeros((len(body.qpos), 1))), 1
        )
        for target, values in (
            (self.qpos, np.concatenate((body.qpos[:, :7], body.qpos[:, self._joints]), 1)),
            (self.qvel, np.concatenate((body.qvel[:, :6], body.joint_velocity()), 1)),
            (self.sensordata, sensed),
            (self.diverged, body.diverged()),
            (self.over, np.full(len(body.qpos), sessions.over)),
            *((self.readings[name], sessions.readings[name]) for name in READINGS),
            *((self.truth[name], values) for name, values in sessions.truth.items()),
        ):
            target.numpy()[rows][chosen] = values[chosen]
