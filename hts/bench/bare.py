"""Bare physics: what was collected, replayed by the engine alone."""

from __future__ import annotations

import time
from typing import Any

import torch

from hts.rl.task_env import LaunchedSimulator
from hts.sim.engine import Engine


class Replay:
    """Remembers what each control step of an engine starts from, and times the same steps with nothing around them.

    `physics` is the time inside `engine.step` while recording, `overhead` the time that remembering itself took, to
    be subtracted from whatever was timed meanwhile; both s.
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

    def seconds(self) -> float:
        """Stop remembering; time of the remembered steps by the engine alone, s. The engine goes on undisturbed."""
        self.recording = False
        synchronise(self.engine.device)
        start = time.perf_counter()
        self.engine.replay(self.steps)
        synchronise(self.engine.device)
        return time.perf_counter() - start

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


def synchronise(device: torch.device) -> None:
    """Wait for a GPU's work; nothing to do on the CPU."""
    if device.type == "cuda":
        torch.cuda.synchronize(device)
