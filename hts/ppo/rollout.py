"""Collection of the velocity task: what TorchRL's Collector would collect, to the bit, with less around the physics.

The Collector asks after every step whether an episode has ended, and puts each step together as nested TensorDicts.
On a CPU leaving that out gains some 4 %. On a GPU, where a step takes a few milliseconds, it would cost more than
the physics; there a control step is three launches: a CUDA graph of everything before the physics (policy, exploration
noise, actuator inputs), the engine's own graph, and a graph of everything after it (reward, measurement models, resets).
The functions that are captured are the ones that run on the CPU.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import torch
from tensordict import TensorDict
from torchrl.envs import EnvBase
from torchrl.envs.transforms import Transform, TransformedEnv

from hts.envs.random import Ahead, PopulationRandom
from hts.envs.velocity import VelocityEnv
from hts.policies.networks import Population
from hts.ppo.capture import Pins, captured, warm_up
from hts.ppo.precision import tf32


def can_roll_out(env: EnvBase) -> bool:
    """Whether env is the velocity task with nothing but measurement models in it; TorchRL's Collector takes any other, and
    one derived from the task that steps or resets in a way of its own."""
    bare, transforms = _parts(env)
    return (
        isinstance(bare, VelocityEnv)
        and type(bare)._step is VelocityEnv._step
        and type(bare)._reset is VelocityEnv._reset
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
    With `aside`, also value [P, N, T] and anchor_mean [P, N, T, J]: computed beside the physics, which leaves room.

    Captured, what `collect` returns lies in memory that the next call overwrites. tf32: matrix products of policy and models in TF32.
    """

    def __init__(
        self, env: EnvBase, population: Population, noise: PopulationRandom, horizon: int, *, capture: bool, tf32: bool = True,
        aside: bool = False, anchor: Population | None = None,
    ) -> None:  # fmt: skip
        bare, self.transforms = _parts(env)
        assert isinstance(bare, VelocityEnv)
        self.env, self.population, self.noise, self.horizon, self.tf32 = bare, population, noise, horizon, tf32
        self.device = bare.device
        self._time = torch.zeros(1, dtype=torch.int64, device=self.device)
        self._rows: dict[tuple[str, ...], torch.Tensor] = {}
        self.anchor, self._with_aside = anchor, aside
        self._graphs: list[torch.cuda.CUDAGraph] = []
        self._capture_first = capture
        self._started = False

    @property
    def captured(self) -> bool:
        """Whether steps are CUDA graphs, so that every batch lies where the last one lay."""
        return bool(self._graphs)

    # -------------------------------------------------------------------------------------------------- one step

    @torch.no_grad()
    def _before(self) -> torch.Tensor:
        """Policy, noise, actuator inputs; what was seen and done goes into the batch."""
        for random in (self.env.random, self.noise):
            if random.ahead is not None:
                random.ahead.begin()
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
    def _aside(self) -> None:
        """What learning wants to know of the states the step began in, and the step itself does not."""
        observation, critic_observation = self.env.observations()
        with tf32(self.tf32):
            self._write(("value",), self.population.value(critic_observation))
            if self.anchor is not None:
                self._write(("anchor_mean",), self.anchor.mean(observation))

    @torch.no_grad()
    def _after(self) -> None:
        """Reward, measurement models, new episodes."""
        out = self.env.finish(self._action)
        nothing = TensorDict({}, batch_size=out.batch_size, device=self.device)
        with tf32(self.tf32):
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
        ctrl = self._before()
        if self._with_aside:
            self._aside()
        self.env.engine.step(ctrl)
        self._after()

    # -------------------------------------------------------------------------------------------------- a batch

    def collect(self) -> TensorDict:
        """The next T steps of every world."""
        if not self._started:
            self._start()
        self._time.zero_()
        if not self._graphs:
            self._rows.clear()  # a batch of its own
            for _ in range(self.horizon):
                self._step()
            return self._batch()
        for random in (self.env.random, self.noise):
            assert random.ahead is not None
            random.ahead.renew()
        before, after, *aside = self._graphs
        here, beside = torch.cuda.current_stream(self.device), self._beside
        for _ in range(self.horizon):
            before.replay()
            for graph in aside:
                beside.wait_stream(here)
                with torch.cuda.stream(beside):
                    graph.replay()
            self.env.engine.step_raw()  # type: ignore[attr-defined]
            if aside:
                here.wait_stream(beside)
            after.replay()
        return self._batch()

    def _batch(self) -> TensorDict:
        parts: dict[Any, torch.Tensor] = {}
        for key, rows in self._rows.items():
            parts[key] = rows.movedim(0, 2) if key != ("last",) else rows
            if not self._graphs:  # laid out alike however many candidates there are: sums take the order of the memory
                parts[key] = parts[key].contiguous()
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
        pins = [Pins(owner, owner.STATE) for owner in owners]
        physics, randoms = engine.state_dict(), (self.env.random, self.noise)
        states = [random.state_dict() for random in randoms]
        for random in randoms:
            random.ahead = Ahead(random, self.horizon, self._time)

        def step() -> None:
            self._time.zero_()
            self._step()
            for pin in pins:
                pin.settle()

        def before() -> None:
            engine.load(self._before())  # type: ignore[attr-defined]

        def after() -> None:
            engine.judge()  # type: ignore[attr-defined]
            self._after()
            for pin in pins:
                pin.settle()

        warm_up(step, self.device)
        self._time.zero_()
        first, _ = captured(before)
        beside = [captured(self._aside)[0]] if self._with_aside else []
        last, _ = captured(after, pool=first.pool())
        self._graphs, self._beside = [first, last, *beside], torch.cuda.Stream(self.device)
        torch.cuda.synchronize(self.device)
        for pin in pins:
            pin.restore()
        engine.load_state_dict(physics)
        for random, state in zip(randoms, states, strict=True):
            random.load_state_dict(state)
