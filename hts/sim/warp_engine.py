"""The GPU engine: `mujoco_warp`, one captured CUDA graph per control step, torch tensors on the same memory."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import mujoco
import torch

from hts.errors import ConfigError, HtsError, SimulationError
from hts.rl.task_env import LaunchedSimulator
from hts.sim.engine import Engine, sensor_slices
from hts.sim.warp_setup import buffer_sizes, explained, import_warp, put_models, torch_device, warp_device

BROKEN = 1e10  # MuJoCo's own limit (mjMAXVAL) of a position or velocity


def make_warp_engine(
    models: Sequence[mujoco.MjModel],
    assignment: Sequence[int],
    substeps: int,
    device: str = "auto",
    contacts_per_world: int = 0,
    constraints_per_world: int = 0,
    keep_physics_steps: bool = False,
) -> WarpEngine:
    """The GPU engine, or a slow twin of it for tests with device="cpu".

    keep_physics_steps: for who asks for `physics_steps`; sensors are then computed in each of them, and not in the last
    alone. contacts_per_world, constraints_per_world: sizes of the buffers, 0 for the worst case of the robot.
    Raises ConfigError where Warp, CUDA or a recent driver is missing or the model is not supported, SimulationError
    where the memory does not suffice.
    """
    place = torch_device(device)
    try:
        return WarpEngine(
            models, assignment, substeps, place, contacts_per_world, constraints_per_world, keep_physics_steps
        )
    except HtsError:
        raise
    except (RuntimeError, ValueError) as error:
        raise explained(error, len(assignment), place) from error


class WarpEngine(Engine, LaunchedSimulator):
    """See `Engine`. Physics runs in single precision; `qpos`, `qvel` and `sensordata` are the physics' own memory.

    Nothing in `step` and `reset` waits for the device: the graph is launched on torch's current stream, so torch and
    Warp work is ordered by that stream. Unlike the CPU engine the solver starts warm from the last step, which is
    therefore part of the saved state. `check` tells, at the price of a wait, whether a buffer has overflowed.
    """

    finite_when_diverged = False

    def __init__(
        self,
        models: Sequence[mujoco.MjModel],
        assignment: Sequence[int],
        substeps: int,
        device: torch.device,
        contacts: int = 0,
        constraints: int = 0,
        keep_physics_steps: bool = False,
    ) -> None:
        self._wp, self._mjw = wp, mjw = import_warp()
        self.num_worlds, self.substeps, self.device = len(assignment), substeps, device
        self._place = warp_device(wp, device)
        self._slices = sensor_slices(models[0])
        with wp.ScopedDevice(self._place):
            self._model = put_models(wp, mjw, models, assignment)
            self._model.opt.warn_overflow = 0  # `check` reports, not a print from the device
            # Where only the last physics step of a control step is seen, only there sensors are worth computing.
            blind = dataclasses.replace(
                self._model.opt, disableflags=self._model.opt.disableflags | mjw.DisableBit.SENSOR
            )
            self._blind = dataclasses.replace(self._model, opt=blind)
            enough = buffer_sizes(models, self._model.nxn_geom_pair_filtered.numpy())
            self._contacts, self._constraints = contacts or enough[0], constraints or enough[1]
            self._data = data = mjw.make_data(
                models[0], nworld=self.num_worlds, nconmax=self._contacts, njmax=self._constraints
            )
            self._inputs = wp.zeros((substeps, self.num_worlds, models[0].nu), dtype=float)
            self._kept = None
            if keep_physics_steps:
                speeds = wp.zeros((substeps + 1, self.num_worlds, models[0].nv), dtype=float)
                self._kept = speeds, wp.zeros((substeps, self.num_worlds, models[0].nsensordata), dtype=float)
        self.qpos, self.qvel, self.sensordata, self._time, self._warmstart, self._overflow, self._ctrl = (
            wp.to_torch(array)
            for array in (
                data.qpos,
                data.qvel,
                data.sensordata,
                data.time,
                data.qacc_warmstart,
                data.overflow,
                self._inputs,
            )
        )
        self._act = wp.to_torch(data.act) if models[0].na else None
        self._steps = [wp.to_torch(array) for array in self._kept or ()]
        self.diverged = torch.zeros(self.num_worlds, dtype=torch.bool, device=device)
        self._bad_input = torch.zeros_like(self.diverged)
        self._streams: dict[int, object] = {}
        self._graph = None
        self._prepare()

    def _prepare(self) -> None:
        """Compile and, on a GPU, capture and launch once, so that whatever can fail fails here. Then start afresh."""
        wp = self._wp
        wp.synchronize_device(self._place)
        start = self.qpos.clone()
        with wp.ScopedDevice(self._place):
            self._launch_all()
            if self._place.is_cuda:
                wp.synchronize_device(self._place)
                # Torch's default stream cannot be captured, a stream of our own can; the graph runs on any.
                self._capture_stream = wp.Stream(self._place)
                with wp.ScopedStream(self._capture_stream), wp.ScopedCapture() as capture:
                    self._launch_all()
                self._graph = capture.graph
                wp.capture_launch(self._graph, stream=self._stream())
                wp.synchronize_device(self._place)
        self.reset(torch.ones_like(self.diverged), start, torch.zeros_like(self.qvel))
        self.sensordata.zero_()
        self._overflow.zero_()

    def _launch_all(self) -> None:
        """Every kernel of one control step, in order."""
        copy, data = self._wp.copy, self._data
        if self._kept is not None:
            copy(self._kept[0][0], data.qvel)
        for index in range(self.substeps):
            copy(data.ctrl, self._inputs[index])
            seen = self._kept is not None or index == self.substeps - 1
            self._mjw.step(self._model if seen else self._blind, data)
            if self._kept is not None:
                speeds, sensors = self._kept
                copy(speeds[index + 1], data.qvel)
                copy(sensors[index], data.sensordata)

    def step(self, ctrl: torch.Tensor) -> None:
        self.load(ctrl)
        self.launch()
        self.flag_diverged()

    def load(self, ctrl: torch.Tensor) -> None:
        """Take the actuator inputs of the next control step, (substeps, W, nu)."""
        self._ctrl.copy_(ctrl)

    def physics_steps(self) -> tuple[torch.Tensor, torch.Tensor] | None:
        if not self._steps:
            return None
        speeds, sensors = (kept.movedim(0, 1) for kept in self._steps)
        return (speeds[:, :-1] + speeds[:, 1:]) / 2, sensors.clone()

    @property
    def inputs(self) -> torch.Tensor:
        """The actuator inputs of the running control step, (substeps, W, nu)."""
        return self._ctrl

    def memory(self) -> list[torch.Tensor]:
        """Every tensor that `load`, `flag_diverged`, `physics_steps` and `reset` read or change, in place."""
        return [*self._saved().values(), self._ctrl, self._bad_input, *self._steps]

    def replay(self, steps: Sequence[tuple[Mapping[str, torch.Tensor], torch.Tensor]]) -> None:
        here = self.state_dict()
        for state, ctrl in steps:
            self.load_state_dict(state)
            self.load(ctrl)
            self.launch()
        self.load_state_dict(here)

    def flag_diverged(self) -> None:
        """After physics: which worlds have broken, and whether an input was not finite."""
        self._bad_input |= ~self._ctrl.isfinite().all(dim=2).all(dim=0)
        # Not-a-number compares false, so it counts as broken too.
        fine = (self.qpos.abs() < BROKEN).all(dim=1) & (self.qvel.abs() < BROKEN).all(dim=1)
        self.diverged |= ~fine

    def launch(self) -> None:
        """Physics alone, from the buffers as they are: what `hts bench` calls bare."""
        if self._graph is None:
            with self._wp.ScopedDevice(self._place):
                self._launch_all()
            return
        try:
            self._wp.capture_launch(self._graph, stream=self._stream())
        except RuntimeError as error:
            raise explained(error, self.num_worlds, self.device) from error

    def _stream(self) -> Any:  # Warp has no types
        """Torch's current stream, as Warp's."""
        current = torch.cuda.current_stream(self.device)
        if current.cuda_stream not in self._streams:
            self._streams[current.cuda_stream] = self._wp.stream_from_torch(current)
        return self._streams[current.cuda_stream]

    def reset(self, mask: torch.Tensor, qpos: torch.Tensor, qvel: torch.Tensor) -> None:
        rows = mask.unsqueeze(-1)
        # `where` and not a product: a broken world holds NaN.
        self.qpos.copy_(torch.where(rows, qpos, self.qpos))
        self.qvel.copy_(torch.where(rows, qvel, self.qvel))
        self._warmstart.masked_fill_(rows, 0.0)
        self._time.masked_fill_(mask, 0.0)
        if self._act is not None:
            self._act.masked_fill_(rows, 0.0)
        self.diverged.masked_fill_(mask, False)

    def nudge(self, velocity: torch.Tensor) -> None:
        self.qvel[:, :2] += velocity

    def sensor(self, name: str) -> slice:
        return self._slices[name]

    def check(self) -> None:
        """Raise SimulationError if a buffer has overflowed or an input was not finite since the start.
        Waits for the device."""
        kind = self._mjw.OverflowType
        contact = kind.BROADPHASE | kind.NARROWPHASE | kind.CCD | kind.HFIELD | kind.EPA_HORIZON
        row = kind.NEFC | kind.NJMAX_NNZ
        found = [(self._overflow & int(bits)) != 0 for bits in (contact, row)] + [self._bad_input]
        contacts, rows, inputs = torch.stack(found).any(dim=1).tolist()
        if contacts:
            raise SimulationError(
                f"More contacts than the warp engine has room for ({self._contacts} per world): some were ignored. "
                "Raise its option contacts_per_world, or use --engine mujoco."
            )
        if rows:
            raise SimulationError(
                f"More constraint rows than the warp engine has room for ({self._constraints} per world): some were "
                "ignored. Raise its option constraints_per_world, or use --engine mujoco."
            )
        if inputs:
            worlds = self._bad_input.nonzero().squeeze(-1)[:8].tolist()
            raise SimulationError(f"A non-finite actuator input reached the physics in worlds {worlds}.")

    def state_dict(self) -> dict[str, torch.Tensor]:
        return {name: tensor.clone() for name, tensor in self._saved().items()}

    def load_state_dict(self, state: Mapping[str, torch.Tensor]) -> None:
        saved = self._saved()
        if saved.keys() != state.keys():
            raise ConfigError(
                f"The saved physics has the parts {sorted(state)}, the warp engine saves {sorted(saved)}: "
                "the checkpoint was written by another engine; resume with the engine that wrote it."
            )
        for name, tensor in saved.items():
            if state[name].shape != tensor.shape:
                raise SimulationError(
                    f"The saved physics has {name} of shape {tuple(state[name].shape)}, this run needs "
                    f"{tuple(tensor.shape)}: the checkpoint is of another robot or another number of worlds."
                )
        for name, tensor in saved.items():
            tensor.copy_(state[name])

    def _saved(self) -> dict[str, torch.Tensor]:
        """All that the next step depends on, and what the last one left to be read."""
        saved = {
            "qpos": self.qpos,
            "qvel": self.qvel,
            "qacc_warmstart": self._warmstart,
            "time": self._time,
            "sensordata": self.sensordata,
            "diverged": self.diverged,
        }
        return saved if self._act is None else saved | {"act": self._act}

    def close(self) -> None:
        if self._place.is_cuda:
            self._wp.synchronize_device(self._place)
        self._graph = None
        self._streams.clear()
