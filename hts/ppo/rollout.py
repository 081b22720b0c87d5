"""Collection on a GPU: the control step of a whole population as CUDA graphs, without the host in the loop.

TorchRL's Collector asks after every step whether an episode has ended, and puts each step together in Python; beside
physics of a few milliseconds that costs more than the physics. Here a control step is three launches: a graph of
everything before the physics (policy, exploration noise, actuator inputs), the engine's own graph, and a graph of
everything after it (reward, measurement models, resets). Each graph also writes its row of the batch.

The same functions run uncaptured on any device, which is how tests compare them with TorchRL's collector.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import torch
from tensordict import TensorDict
from torchrl.envs import EnvBase
from torchrl.envs.transforms import Transform, TransformedEnv

from hts.envs.random import PopulationRandom
from hts.envs.velocity import VelocityEnv
from hts.policies.networks import Population
from hts.ppo.precision import tf32

WARM_UP = 3  # steps before capture, so that libraries have their workspaces; undone afterwards


def can_be_captured(env: EnvBase) -> bool:
    """Whether env, its transforms included, is known never to wait for the device: the velocity task on a GPU."""
    bare, transforms = _parts(env)
    return (
        isinstance(bare, VelocityEnv)
        and bare.device.type == "cuda"
        and all(getattr(transform, "never_waits", False) for transform in transforms)
    )


def _parts(env: EnvBase) -> tuple[EnvBase, list[Transform]]:
    if not isinstance(env, TransformedEnv):
        return env, []
    transform = env.transform
    return env.base_env, list(transform) if isinstance(transform, Iterable) else [transform]


class Rollout:
    """Batches [P, N, T] of a population's steps. Keys: observation, critic_observation, action, action_mean, and under
    "next": reward, terminated, truncated, ("real_reward", objective), critic_observation [P, N, 1, O_c] of the last step.

    What `collect` returns lies in memory that the next call overwrites. tf32: matrix products of the policy in TF32.
    """

    def __init__(
        self, env: EnvBase, population: Population, noise: PopulationRandom, horizon: int, *, capture: bool, tf32: bool = True
    ) -> None:  # fmt: skip
        bare, self.transforms = _parts(env)
        assert isinstance(bare, VelocityEnv)
        self.env, self.population, self.noise, self.horizon, self.tf32 = bare, population, noise, horizon, tf32
        self.device = bare.device
        self._time = torch.zeros(1, dtype=torch.int64, device=self.device)
        self._rows: dict[tuple[str, ...], torch.Tensor] = {}
        self._graphs: tuple[torch.cuda.CUDAGraph, torch.cuda.CUDAGraph] | None = None
        self._capture_first = capture
        self._started = False

    # -------------------------------------------------------------------------------------------------- one step

    @torch.no_grad()
    def _before(self) -> torch.Tensor:
        """Policy, noise, actuator inputs; what was seen and done goes into the batch."""
        observation, critic_observation = self.env.observations()
        with tf32(self.tf32):
            mean = self.population.mean(observation)
        self._action = mean + self.population.log_std().exp() * self.noise.normal(*mean.shape[1:])
        self._write(("observation",), observation)
        self._write(("critic_observation",), critic_observation)
        self._write(("action",), self._action)
        self._write(("action_mean",), mean)
        return self.env.begin(self._action)

    @torch.no_grad()
    def _after(self) -> None:
        """Reward, measurement models, new episodes."""
        out = self.env.finish(self._action)
        nothing = TensorDict({}, batch_size=out.batch_size, device=self.device)
        for transform in self.transforms:
            out = transform._step(nothing, out)
        for name in ("reward", "terminated", "truncated"):
            self._write(("next", name), out[name])
        for name, value in out.get("real_reward", TensorDict()).items():
            self._write(("next", "real_reward", name), value)
        self._keep("last", out["critic_observation"])
        done = out["done"]
        if self.device.type != "cpu" or bool(done.any()):
            self.env.start_episodes(done.view(out.batch_size))
            mask = TensorDict({"_reset": done}, batch_size=out.batch_size, device=self.device)
            for transform in self.transforms:
                transform._reset(mask, nothing)
        self._time += 1

    def _write(self, key: tuple[str, ...], value: torch.Tensor) -> None:
        """One row of the batch, [T, P, N, ...]."""
        if key not in self._rows:
            self._rows[key] = torch.zeros(self.horizon, *value.shape, dtype=value.dtype, device=self.device)
        self._rows[key].index_copy_(0, self._time, value.unsqueeze(0))

    def _keep(self, name: str, value: torch.Tensor) -> None:
        if (name,) not in self._rows:
            self._rows[name,] = torch.zeros_like(value)
        self._rows[name,].copy_(value)

    def _step(self) -> None:
        self.env.engine.step(self._before())
        self._after()

    # -------------------------------------------------------------------------------------------------- a batch

    def collect(self) -> TensorDict:
        """The next T steps of every world."""
        if not self._started:
            self._start()
        self._time.zero_()
        if self._graphs is None:
            for _ in range(self.horizon):
                self._step()
        else:
            before, after = self._graphs
            engine = self.env.engine
            for _ in range(self.horizon):
                before.replay()
                engine.step_raw()  # type: ignore[attr-defined]
                after.replay()
        return self._batch()

    def _batch(self) -> TensorDict:
        parts: dict[Any, torch.Tensor] = {}
        for key, rows in self._rows.items():
            parts[key] = rows.movedim(0, 2) if key != ("last",) else rows
        parts["next", "critic_observation"] = parts.pop(("last",)).unsqueeze(2)
        count, worlds = self.env.batch_size
        batch = TensorDict({}, batch_size=[count, worlds], device=self.device)
        for key, value in parts.items():
            batch[key] = value
        return batch

    def _start(self) -> None:
        """The first episodes; on a GPU then the capture."""
        self._started = True
        self.env.reset()  # goes on where a checkpoint ended, if one was loaded
        if self._capture_first:
            self._capture()

    # -------------------------------------------------------------------------------------------------- capture

    def _capture(self) -> None:
        """Warm up, capture both graphs, and put everything back to where it was."""
        engine = self.env.engine
        owners = [self.env, self.env.commands, *(one for one in self.transforms if hasattr(one, "prepare"))]
        for transform in self.transforms:
            if hasattr(transform, "prepare"):
                transform.prepare(self.env.batch_size.numel(), self.device)
        pins = [_Pins(owner, owner.STATE) for owner in owners]
        physics, generators = engine.state_dict(), [*self.env.random.generators, *self.noise.generators]
        random = [generator.get_state() for generator in generators]
        stream = torch.cuda.Stream(self.device)
        stream.wait_stream(torch.cuda.current_stream(self.device))
        with torch.cuda.stream(stream):
            for _ in range(WARM_UP):
                self._time.zero_()
                self._step()
                for pin in pins:
                    pin.settle()
        torch.cuda.current_stream(self.device).wait_stream(stream)
        torch.cuda.synchronize(self.device)
        before, after = torch.cuda.CUDAGraph(), torch.cuda.CUDAGraph()
        for generator in generators:
            before.register_generator_state(generator)
        with torch.cuda.graph(before):
            engine.load(self._before())  # type: ignore[attr-defined]
        with torch.cuda.graph(after, pool=before.pool()):
            engine.judge()  # type: ignore[attr-defined]
            self._after()
            for pin in pins:
                pin.settle()
        self._graphs = (before, after)
        torch.cuda.synchronize(self.device)
        for pin in pins:
            pin.restore()
        engine.load_state_dict(physics)
        for generator, state in zip(generators, random, strict=True):
            generator.set_state(state)


class _Pins:
    """State that a step replaces, held in the same memory from step to step, as a captured graph needs it.

    `settle`, at the end of a step, copies what the step made into the pinned memory and puts that back in place.
    """

    def __init__(self, owner: Any, names: Iterable[str]) -> None:
        self.owner, self.names = owner, [name for name in names if getattr(owner, name, None) is not None]
        self.fixed = {name: getattr(owner, name).clone() for name in self.names}
        self.begun = {name: value.clone() for name, value in self.fixed.items()}
        self._attach()

    def _attach(self) -> None:
        for name, value in self.fixed.items():
            setattr(self.owner, name, value)

    def settle(self) -> None:
        for name, value in self.fixed.items():
            made = getattr(self.owner, name)
            if made is not value:
                value.copy_(made)
        self._attach()

    def restore(self) -> None:
        for name, value in self.fixed.items():
            value.copy_(self.begun[name])
        self._attach()
