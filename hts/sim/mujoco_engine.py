"""The CPU engine: `mujoco.rollout` with a persistent thread pool."""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence

import mujoco
import numpy as np
import torch
from mujoco import rollout

from hts.cores import available
from hts.errors import SimulationError
from hts.sim.engine import Engine, sensor_slices

FULL = mujoco.mjtState.mjSTATE_FULLPHYSICS
CTRL = int(mujoco.mjtState.mjSTATE_CTRL)
FEW_GEOMS = 64
LARGEST_CHUNK = 4  # worlds


def lean(model: mujoco.MjModel) -> mujoco.MjModel:
    """A copy whose steps take less time, to the same bits.

    Constraints of a single tree are one island, so it is not looked for; and where geoms are few, trying all pairs
    of them is cheaper than going down trees of their boxes.
    """
    model, flags = copy.copy(model), mujoco.mjtDisableBit
    if model.ntree == 1:
        model.opt.disableflags |= flags.mjDSBL_ISLAND
    if model.ngeom <= FEW_GEOMS:
        model.opt.disableflags |= flags.mjDSBL_MIDPHASE
    return model


class MujocoEngine(Engine):
    """See `Engine`. Physics runs in double precision; the tensors are single-precision copies.

    threads: size of the pool, 0 for one per core. A world's result depends neither on the threads nor on its
    neighbours: each world is integrated alone, from its full state, with a zero solver warm start.
    """

    def __init__(
        self, models: Sequence[mujoco.MjModel], assignment: Sequence[int], substeps: int, threads: int = 0
    ) -> None:
        pool = {id(model): lean(model) for model in models}  # one of each, however often it is named
        self.models = [pool[id(models[index])] for index in assignment]
        model = self.models[0]
        self.num_worlds = worlds = len(self.models)
        self.substeps = substeps
        self.device = torch.device("cpu")
        self.threads = threads or available()
        self._pool = rollout.Rollout(nthread=self.threads)
        self._datas = [mujoco.MjData(model) for _ in range(self.threads)]
        self._slices = sensor_slices(model)
        size = mujoco.mj_stateSize(model, FULL)
        if size != 1 + model.nq + model.nv:
            raise SimulationError(
                f"The model has {size} state numbers, expected time, qpos and qvel only ({1 + model.nq + model.nv}): "
                "actuators with an internal state are not supported by the mujoco engine."
            )
        self._nq, self._dt = model.nq, model.opt.timestep
        self._state = np.zeros((worlds, size))
        self._states = np.zeros((worlds, substeps, size))
        self._before = np.zeros((worlds, size))  # the state that the last control step began with
        self._sensors = np.zeros((worlds, substeps, model.nsensordata))
        self._ctrl = np.zeros((worlds, substeps, model.nu))
        self._warmstart = np.zeros((worlds, model.nv))
        # Small chunks keep all threads busy to the end, although airborne robots run twice as fast and a core may have
        # other work too.
        self._chunk = max(1, min(LARGEST_CHUNK, worlds // (4 * self.threads)))
        self.qpos = torch.zeros(worlds, model.nq)
        self.qvel = torch.zeros(worlds, model.nv)
        self.sensordata = torch.zeros(worlds, model.nsensordata)
        self.diverged = torch.zeros(worlds, dtype=torch.bool)

    def step(self, ctrl: torch.Tensor) -> None:
        self._ctrl[:] = ctrl.transpose(0, 1).numpy()
        if not np.isfinite(self._ctrl).all():
            bad = np.flatnonzero(~np.isfinite(self._ctrl).all(axis=(1, 2)))
            raise SimulationError(f"A non-finite actuator input reached the physics in worlds {bad[:8].tolist()}.")
        self._before[:] = self._state
        self._rollout(self._state, self._ctrl)
        self._state[:] = self._states[:, -1]
        nq = self._nq
        # In numpy, which needs less time to begin with something small.
        self.qpos.numpy()[:] = self._state[:, 1 : 1 + nq]
        self.qvel.numpy()[:] = self._state[:, 1 + nq :]
        self.sensordata.numpy()[:] = self._sensors[:, -1]
        # A world that MuJoCo gave up on comes back finite with its clock frozen: only the clock tells.
        self.diverged.numpy()[:] = self._state[:, 0] - self._before[:, 0] < (self.substeps - 0.5) * self._dt

    def _rollout(self, state: np.ndarray, ctrl: np.ndarray) -> None:
        """All worlds from state (W, size) with ctrl (W, substeps, nu), into `_states` and `_sensors`."""
        self._pool.rollout(
            self.models,
            self._datas,
            state,
            ctrl,
            control_spec=CTRL,
            skip_checks=True,
            nstep=self.substeps,
            initial_warmstart=self._warmstart,
            state=self._states,
            sensordata=self._sensors,
            chunk_size=self._chunk,
        )

    def physics_steps(self) -> tuple[torch.Tensor, torch.Tensor]:
        qvel = self._states[:, :, 1 + self._nq :]
        first = self._before[:, None, 1 + self._nq :]
        before = np.concatenate((first, qvel[:, :-1]), 1)
        return torch.from_numpy((before + qvel) / 2).float(), torch.from_numpy(self._sensors).float()

    def snapshot(self, ctrl: torch.Tensor) -> tuple[np.ndarray, np.ndarray]:
        return self._state.copy(), ctrl.transpose(0, 1).double().numpy().copy()

    def replay(self, steps: Sequence[tuple[np.ndarray, np.ndarray]]) -> None:
        for state, ctrl in steps:
            self._rollout(state, ctrl)

    def reset(self, mask: torch.Tensor, qpos: torch.Tensor, qvel: torch.Tensor) -> None:
        rows = mask.nonzero().squeeze(-1)
        if not rows.numel():
            return
        index = rows.numpy()
        self._state[index, 1 : 1 + self._nq] = qpos[rows].numpy()
        self._state[index, 1 + self._nq :] = qvel[rows].numpy()
        self.qpos[rows] = qpos[rows]
        self.qvel[rows] = qvel[rows]
        self.diverged[rows] = False

    def push(self, mask: torch.Tensor, velocity: torch.Tensor) -> None:
        rows = mask.nonzero().squeeze(-1)
        self.qvel[rows, :2] += velocity[rows]
        self._state[rows.numpy(), 1:] = torch.cat((self.qpos[rows], self.qvel[rows]), -1).numpy()

    def nudge(self, velocity: torch.Tensor) -> None:
        self.qvel[:, :2] += velocity
        first = 1 + self._nq  # after the clock and the positions
        self._state[:, first : first + 2] = self.qvel[:, :2].numpy()

    def sensor(self, name: str) -> slice:
        return self._slices[name]

    def state_dict(self) -> dict[str, torch.Tensor]:
        return {"state": torch.from_numpy(self._state.copy()), "sensordata": self.sensordata.clone()}

    def load_state_dict(self, state: Mapping[str, torch.Tensor]) -> None:
        if state["state"].shape != self._state.shape:
            raise SimulationError(
                f"The saved physics has shape {tuple(state['state'].shape)}, this run needs {self._state.shape}: "
                "the checkpoint is of another robot or another number of worlds."
            )
        self._state[:] = state["state"].numpy()
        self.qpos[:] = torch.from_numpy(self._state[:, 1 : 1 + self._nq])
        self.qvel[:] = torch.from_numpy(self._state[:, 1 + self._nq :])
        self.sensordata[:] = state["sensordata"]
        self.diverged.zero_()

    def close(self) -> None:
        self._pool.close()
