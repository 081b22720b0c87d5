"""Collection on a GPU: a control step is three launches, and nothing in it waits for the host.

They are a CUDA graph of everything before the physics (policy, exploration noise, actuator inputs), the engine's own graph,
and a graph of everything after it (reward, measurement models, resets). Where torch.compile can work, what is captured are
compiled programs of these parts.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import torch
from tensordict import TensorDict
from torchrl.envs import EnvBase

from hts.rl.capture import Pins, captured, explained, warm_up
from hts.rl.population import Population
from hts.rl.population_collector import Key, Rollout
from hts.rl.precision import tf32
from hts.rl.random import Ahead, PopulationRandom
from hts.rl.tracing import Program, anything, can_fuse

Part = Callable[..., tuple[torch.Tensor, ...]]


class CapturedRollout(Rollout):
    """See `Rollout`. What `collect` returns lies in memory that the next call overwrites.

    With `aside`, also value [P, N, T] and anchor_mean [P, N, T, J]: computed beside the physics, which leaves room.
    capture: False takes the same steps one operation after the other. tf32: matrix products of policy and models in TF32;
    fuse: programs of the parts, None where they can be compiled.
    """

    def __init__(
        self, env: EnvBase, population: Population, noise: PopulationRandom, horizon: int, *, capture: bool, tf32: bool = True,
        aside: bool = False, anchor: Population | None = None, fuse: bool | None = None,
    ) -> None:  # fmt: skip
        super().__init__(env, population, noise, horizon)
        self.tf32, self.anchor, self._with_aside = tf32, anchor, aside
        self._time = torch.zeros(1, dtype=torch.int64, device=self.device)
        self._rows: dict[Key, torch.Tensor] = {}
        self._graphs: list[torch.cuda.CUDAGraph] = []
        self._capture_first = capture
        self._fuse = capture and (can_fuse(self.device) if fuse is None else fuse)
        self._parts: dict[str, Part] = {
            "decide": self._decide, "look_aside": self._look_aside, "end": self._end_step,
        }  # fmt: skip
        self._outcomes: list[Key] = []

    @property
    def captured(self) -> bool:  # type: ignore[override]
        return bool(self._graphs)

    # ------------------------------------------------------------------------------------- the parts of a step

    # What they compute, from the state of env, engine and models, and into it. A program is made of each.

    def _decide(self) -> tuple[torch.Tensor, ...]:
        for random in (self.env.random, self.noise):
            if random.ahead is not None:
                random.ahead.begin()
        return super()._decide()

    def _look_aside(self) -> tuple[torch.Tensor, ...]:
        """What learning wants to know of the states the step began in, and the step itself does not: values, anchor's means."""
        observation, critic_observation = self.env.observations()
        value = self.population.value(critic_observation)
        return (value,) if self.anchor is None else (value, self.anchor.mean(observation))

    def _end_step(self, action: torch.Tensor) -> tuple[torch.Tensor, ...]:
        """After the physics: reward and measurement models, and at last what the critic saw before new episodes began."""
        out = self.env.finish(action)
        nothing = TensorDict({}, batch_size=out.batch_size, device=self.device)
        for transform in self.transforms:
            out = transform._step(nothing, out)
        outcome: dict[Key, torch.Tensor] = {("next", name): out[name] for name in ("reward", "terminated", "truncated")}
        for name, value in out.get("real_reward", TensorDict()).items():
            outcome["next", "real_reward", name] = value
        self._outcomes = list(outcome)
        last, done = out["critic_observation"], out["done"]
        if anything(done):
            self.env.start_episodes(done.view(out.batch_size))
            mask = TensorDict({"_reset": done}, batch_size=out.batch_size, device=self.device)
            for transform in self.transforms:
                transform._reset(mask, nothing)
        return *outcome.values(), last

    # -------------------------------------------------------------------------------------------------- a step

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
        with tf32(self.tf32):
            *outcome, last = self._parts["end"](self._action)
        for key, value in zip(self._outcomes, outcome, strict=True):
            self._write(key, value)
        if ("last",) not in self._rows:
            self._rows["last",] = torch.zeros_like(last)
        self._rows["last",].copy_(last)
        self._time += 1

    def _write(self, key: Key, value: torch.Tensor) -> None:
        """One row of the batch, [T, P, N, ...]."""
        if key not in self._rows:
            self._rows[key] = torch.zeros(self.horizon, *value.shape, dtype=value.dtype, device=self.device)
        self._rows[key].index_copy_(0, self._time, value.unsqueeze(0))

    # -------------------------------------------------------------------------------------------------- a batch

    def _collect(self) -> TensorDict:
        self._time.zero_()
        if not self._graphs:
            self._rows.clear()  # a batch of its own
            for _ in range(self.horizon):
                ctrl = self._before()
                if self._with_aside:
                    self._aside()
                self.env.engine.step(ctrl)
                self._after()
        else:
            self._replay()
        rows = {key: value.movedim(0, 2) for key, value in self._rows.items() if key != ("last",)}
        return self._batch(rows, self._rows["last",])

    def _replay(self) -> None:
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

    # -------------------------------------------------------------------------------------------------- capture

    def _start(self) -> None:
        if self._capture_first:
            self._capture()

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

        def end(action: torch.Tensor) -> tuple[torch.Tensor, ...]:
            self.env.engine.judge()  # type: ignore[attr-defined]
            return self._end_step(action)

        self._parts["decide"], self._parts["end"] = partial(settled, self._decide), partial(settled, end)
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
        for name in ("decide", "look_aside", "end") if self._with_aside else ("decide", "end"):
            given = [self._action] if name == "end" else []
            self._parts[name] = _program(self._parts[name], given, state, compiled)


def _program(part: Part, given: Sequence[torch.Tensor], state: Sequence[torch.Tensor], compiled: bool) -> Part:
    """The program of a part of a step; given: what it is called with; state: what else it reads, and changes in place."""
    with explained():
        program = Program(lambda *tensors: part(*tensors[: len(given)]), [*given, *state], compiled)
    return lambda *given: program(*given, *state)
