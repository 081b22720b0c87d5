"""Bare physics: what was collected, replayed by the engine alone."""

from __future__ import annotations

import statistics
import time
from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from torchrl.envs import EnvBase

from hts.rl.deferred import base_and_transforms
from hts.rl.task_env import LaunchedSimulator
from hts.sim.engine import Engine
from hts.sim.mujoco_engine import MujocoEngine


class Recorder:
    """Remembers what each control step of an engine starts from.

    `physics` is the time inside `engine.step` while recording, `overhead` the time that remembering itself took; s.
    """

    def __init__(self, engine: Engine) -> None:
        self.engine = engine
        self.recording = False
        self.physics = self.overhead = 0.0
        self.steps: list[Any] = []
        # Where control steps are captured, only the launch of the physics goes through Python.
        name, wrapper = ("launch", self._launch) if isinstance(engine, LaunchedSimulator) else ("step", self._step)
        self._engine_step = getattr(engine, name)
        setattr(engine, name, wrapper)

    def start(self) -> None:
        """Forget everything and remember from here on."""
        self.steps.clear()
        self.physics = self.overhead = 0.0
        self.recording = True

    def _launch(self) -> None:
        if self.recording:
            self.steps.append(self.engine.snapshot(self.engine.inputs))  # type: ignore[attr-defined]
        self._engine_step()

    def _step(self, ctrl: torch.Tensor) -> None:
        if not self.recording:
            self._engine_step(ctrl)
            return
        start = time.perf_counter()
        self.steps.append(self.engine.snapshot(ctrl))
        middle = time.perf_counter()
        self._engine_step(ctrl)
        self.overhead += middle - start
        self.physics += time.perf_counter() - middle


class Replay:
    """Times the control steps of a trainer's engines again, with nothing around them.

    Engines that are stepped side by side, each with its own candidates, are replayed as one engine of all worlds with
    a thread per core: bare physics is the fastest that the machine can do, however collection divides it.
    """

    def __init__(self, engines: Sequence[Engine]) -> None:
        self.recorders = [Recorder(engine) for engine in engines]
        self.engine = engines[0] if len(engines) == 1 else _whole(engines)

    def start(self) -> None:
        """Forget everything and remember from here on."""
        for recorder in self.recorders:
            recorder.start()

    @property
    def overhead(self) -> float:
        """What remembering added to whatever was timed meanwhile, s: engines remember side by side."""
        return statistics.mean(recorder.overhead for recorder in self.recorders)

    @property
    def steps(self) -> list[Any]:
        """What was remembered, of all worlds."""
        if len(self.recorders) == 1:
            return self.recorders[0].steps
        together = zip(*(recorder.steps for recorder in self.recorders), strict=True)
        return [tuple(np.concatenate(parts) for parts in zip(*step, strict=True)) for step in together]

    def seconds(self) -> float:
        """Stop remembering; time of the remembered steps by the engine alone, s. Engines go on undisturbed."""
        for recorder in self.recorders:
            recorder.recording = False
        steps = self.steps
        synchronise(self.engine.device)
        start = time.perf_counter()
        self.engine.replay(steps)
        synchronise(self.engine.device)
        return time.perf_counter() - start


def engines_of(env: EnvBase) -> list[Engine]:
    """The engine of each group of candidates."""
    return [group.engine for group in base_and_transforms(env)[0].groups()]


def _whole(engines: Sequence[Engine]) -> MujocoEngine:
    """One engine with the worlds of all, which are on a CPU."""
    parts = [engine for engine in engines if isinstance(engine, MujocoEngine)]
    models = [model for engine in parts for model in engine.models]
    return MujocoEngine(models, range(len(models)), parts[0].substeps, parts[0].threads)


def synchronise(device: torch.device) -> None:
    """Wait for a GPU's work; nothing to do on the CPU."""
    if device.type == "cuda":
        torch.cuda.synchronize(device)
