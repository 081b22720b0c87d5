"""Collection of the velocity task: what TorchRL's Collector would collect, to the bit, with less around the physics.

The Collector asks after every step whether an episode has ended, and puts each step together as nested TensorDicts.
On a CPU leaving that out gains some 4 %. On a GPU, where a step takes a few milliseconds, it would cost more than
the physics; there a control step is three launches: a CUDA graph of everything before the physics (policy, exploration
noise, actuator inputs), the engine's own graph, and a graph of everything after it (reward, measurement models, resets).
The functions that are captured are the ones that run on the CPU.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from functools import partial
from typing import Any

import torch
from tensordict import TensorDict
from torchrl.envs import EnvBase
from torchrl.envs.transforms import Transform, TransformedEnv

from hts.envs.random import Ahead, PopulationRandom
from hts.envs.velocity import VelocityEnv
from hts.fusing import Program, anything, can_fuse
from hts.policies.networks import Population
from hts.ppo.capture import Pins, captured, warm_up
from hts.ppo.precision import tf32

Part = Callable[..., tuple[torch.Tensor, ...]]


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
        aside: bool = False, anchor: Population | None = None, fuse: bool | None = None,
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
        self._fuse = capture and (can_fuse(self.device) if fuse is None else fuse)
        self._parts: dict[str, Part] = {
            "decide": self._decide, "look_aside": self._look_aside, "judge": self._judge,
        }  # fmt: skip
        self._judged: list[tuple[str, ...]] = []
        self._started = False

    @property
    def captured(self) -> bool:
        """Whether steps are CUDA graphs, so that every batch lies where the last one lay."""
        return bool(self._graphs)

    # -------------------------------------------------------------------------------------------------- one step

    # What a step computes: from the state of env, engine and models, and into it. `Program`s of these run on a GPU.

    def _decide(self) -> tuple[torch.Tensor, ...]:
        """Before the physics: observation, critic observation, action, its mean, actuator inputs."""
        for random in (self.env.random, self.noise):
            if random.ahead is not None:
                random.ahead.begin()
        observation, critic_observation = self.env.observations()
        mean = self.population.mean(observation)
        action = mean + self.population.log_std().exp() * self.noise.normal(*mean.shape[1:])
        return observation, critic_observation, action, mean, self.env.begin(action)

    def _look_aside(self) -> tuple[torch.Tensor, ...]:
        """What learning wants to know of the states the step began in, and the step itself does not: values, anchor's means."""
        observation, critic_observation = self.env.observations()
        value = self.population.value(critic_observation)
        return (value,) if self.anchor is None else (value, self.anchor.mean(observation))

    def _judge(self, action: torch.Tensor) -> tuple[torch.Tensor, ...]:
        """After the physics: reward, measurement models, new episodes."""
        out = self.env.finish(action)
        nothing = TensorDict({}, batch_size=out.batch_size, device=self.device)
        for transform in self.transforms:
            out = transform._step(nothing, out)
        outcome = {("next", name): out[name] for name in ("reward", "terminated", "truncated")}
        for name, value in out.get("real_reward", TensorDict()).items():
            outcome["next", "real_reward", name] = value
        self._judged = list(outcome)
        last, done = out["critic_observation"], out["done"]
        if anything(done):
            self.env.start_episodes(done.view(out.batch_size))
            mask = TensorDict({"_reset": done}, batch_size=out.batch_size, device=self.device)
            for transform in self.transforms:
                transform._reset(mask, nothing)
        return *outcome.values(), last

    @torch.no_grad()
    def _before(self) -> torch.Tensor:
        """Policy, noise, actuator inputs; what was seen and done goes into the batch."""
        with tf32(self.tf32):
            *seen, ctrl = self._parts["decide"]()
        self._action = seen[2]
        for name, value in zip(("observation", "critic_observation", "action", "action_mean"), seen, strict=True):
            self._write((name,), value)
        return ctrl

    @torch.no_grad()
    def _aside(self) -> None:
        with tf32(self.tf32):
            found = self._parts["look_aside"]()
        for name, value in zip(("value", "anchor_mean"), found, strict=False):
            self._write((name,), value)

    @torch.no_grad()
    def _after(self) -> None:
        """Reward, measurement models, new episodes."""
        with tf32(self.tf32):
            *outcome, last = self._parts["judge"](self._action)
        for key, value in zip(self._judged, outcome, strict=True):
            self._write(key, value)
        self._keep("last", last)
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
        """Warm up, write the programs, capture the graphs, and put everything back to where it was."""
        engine, randoms = self.env.engine, (self.env.random, self.noise)
        physics, states = engine.state_dict(), [random.state_dict() for random in randoms]
        pins = self._pin()
        warm_up(self._one_step, self.device)
        if self._fuse:
            self._write_programs(pins)
            warm_up(self._one_step, self.device)
        self._time.zero_()
        first, _ = captured(lambda: engine.load(self._before()))  # type: ignore[attr-defined]
        beside = [captured(self._aside)[0]] if self._with_aside else []
        last, _ = captured(self._after, pool=first.pool())
        self._graphs, self._beside = [first, last, *beside], torch.cuda.Stream(self.device)
        torch.cuda.synchronize(self.device)
        for pin in pins:
            pin.restore()
        engine.load_state_dict(physics)
        for random, state in zip(randoms, states, strict=True):
            random.load_state_dict(state)

    def _pin(self) -> list[Pins]:
        """From here on a step leaves its state in the memory where it found it, and takes numbers that were drawn ahead."""
        owners: list[Any] = [self.env, self.env.commands]
        for transform in self.transforms:
            if hasattr(transform, "prepare"):
                transform.prepare(self.env.batch_size.numel(), self.device)
                owners.append(transform)
        pins = [Pins(owner, owner.STATE) for owner in owners]
        for random in (self.env.random, self.noise):
            random.ahead = Ahead(random, self.horizon, self._time)

        def settled(part: Part, *given: torch.Tensor) -> tuple[torch.Tensor, ...]:
            result = part(*given)
            for pin in pins:
                pin.settle()
            return result

        def judge(action: torch.Tensor) -> tuple[torch.Tensor, ...]:
            self.env.engine.judge()  # type: ignore[attr-defined]
            return self._judge(action)

        self._parts["decide"], self._parts["judge"] = partial(settled, self._decide), partial(settled, judge)
        return pins

    def _one_step(self) -> None:
        """A step as it is captured: what `Engine.step` does around the physics belongs to the parts before and after."""
        self._time.zero_()
        self.env.engine.load(self._before())  # type: ignore[attr-defined]
        if self._with_aside:
            self._aside()
        self.env.engine.step_raw()  # type: ignore[attr-defined]
        self._after()

    def _write_programs(self, pins: Sequence[Pins], compiled: bool = True) -> None:
        """Put programs in place of the parts of a pinned step that has been taken once."""
        memory = self.env.engine.memory()  # type: ignore[attr-defined]
        state = [*(tensor for pin in pins for tensor in pin.fixed.values()), *memory, self._time]
        for name in ("decide", "look_aside", "judge") if self._with_aside else ("decide", "judge"):
            given = [self._action] if name == "judge" else []
            self._parts[name] = _program(self._parts[name], given, state, compiled)


def _program(part: Part, given: Sequence[torch.Tensor], state: Sequence[torch.Tensor], compiled: bool) -> Part:
    """The program of a part of a step; given: what it is called with; state: what else it reads, and changes in place."""
    program = Program(lambda *tensors: part(*tensors[: len(given)]), [*given, *state], compiled)
    return lambda *given: program(*given, *state)
