"""Collection on a GPU: a control step is three launches, and nothing in it waits for the host.

They are a CUDA graph of everything before the physics (policy, exploration noise, the simulator's inputs), the
simulator's own, and a graph of everything after it (reward, measurements, resets). Where torch.compile can work, what
is captured are compiled traces of these parts.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import torch
from tensordict import TensorDict
from tensordict.utils import unravel_key
from torchrl.envs import EnvBase

from hts.rl.actor import PopulationActor, log_prob
from hts.rl.capture import StaticBuffers, captured, explained, warm_up
from hts.rl.collector_checks import FLAGS, Key, check_flags, checked_rewards
from hts.rl.population import Population
from hts.rl.population_collector import SplitStepCollector, decide
from hts.rl.precision import tf32
from hts.rl.random import PopulationRandom, PrefetchedNoise
from hts.rl.task_env import LaunchedSimulator, ReplacedState
from hts.rl.tracing import TracedGraph, any_or_tracing, can_compile

Part = Callable[..., tuple[torch.Tensor, ...]]


class CapturedCollector(SplitStepCollector):
    """`PopulationCollector` for a GPU, with the same batches. A batch lies in memory that the next one overwrites.

    side_stream: also state_value [P, N, T, 1], and reference_loc [P, N, T, A] where there is a reference: what learning
    wants to know of the states that steps begin in, computed beside the physics, which leaves room. capture: False
    takes the same steps one operation after the other; the env then needs no `launched_simulator`. tf32: matrix
    products in TF32; compiled: traces of the parts through torch.compile, None where that can work.
    """

    def __init__(
        self,
        env: EnvBase,
        policy: PopulationActor,
        *,
        frames_per_batch: int,
        total_frames: int = -1,
        capture: bool = True,
        tf32: bool = True,
        side_stream: bool = False,
        reference: Population | None = None,
        compiled: bool | None = None,
    ) -> None:
        super().__init__(env, policy, frames_per_batch=frames_per_batch, total_frames=total_frames)
        device = self.bare_env.device
        self.tf32, self.reference, self._with_side = tf32, reference, side_stream
        self._time = torch.zeros(1, dtype=torch.int64, device=device)
        self._rows: dict[Key, torch.Tensor] = {}
        self._graphs: list[torch.cuda.CUDAGraph] = []
        self._wants_capture = capture
        self._compiled = capture and (can_compile(device) if compiled is None else compiled)
        self._parts: dict[str, Part] = {
            "before": self._begin_step,
            "side": self._look_aside,
            "after": self._end_step,
        }
        self._keys: dict[str, list[Key]] = {}

    @property
    def captured(self) -> bool:
        """Whether steps are graphs, so that every batch lies where the last one lay."""
        return bool(self._graphs)

    # ------------------------------------------------------------------------------------- the parts of a step

    # What they compute, from the state of env, simulator and transforms, and into it. A trace is made of each.

    def _begin_step(self) -> tuple[torch.Tensor, ...]:
        """Policy, noise, the simulator's inputs; the latter come last."""
        for random in self._randoms():
            random.begin_step()
        log_std = self.policy.log_std(ndim=3)
        step, inputs = decide(self.bare_env, self.policy, log_std.exp())
        step["action_log_prob",] = log_prob(step["action",], step["loc",], log_std)
        self._keys["before"] = list(step)
        return *step.values(), inputs

    def _look_aside(self) -> tuple[torch.Tensor, ...]:
        """Values, and the reference's mean actions, in the states that the step begins in."""
        seen = self.bare_env.observations()
        found = {("state_value",): self.policy.population.value(seen["critic_observation"]).unsqueeze(-1)}
        if self.reference is not None:
            found["reference_loc",] = self.reference.mean(seen["observation"])
        self._keys["side"] = list(found)
        return tuple(found.values())

    def _end_step(self, action: torch.Tensor) -> tuple[torch.Tensor, ...]:
        """After the physics: reward, measurements, and at last new episodes where old ones have ended."""
        env = self.bare_env
        ended, flags = env.end_step(action)
        check_flags(env, flags)
        reward = checked_rewards(env, [ended])[0]
        outcome = {("reward",): reward.unsqueeze(-1)} | {(name,): flags[name] for name in FLAGS}
        channels = env.channel_values() if self.transforms else {}
        for transform in self.transforms:
            measured = transform.evaluate(transform.record(channels))
            outcome |= {key: value.view(*env.batch_size, 1) for key, value in measured.items()}
        outcome |= {(name,): value for name, value in env.observations().items()}
        self._keys["after"] = [unravel_key(("next", key)) for key in outcome]
        done = flags["done"]
        if any_or_tracing(done):
            env.start_episodes(done.view(env.batch_size))
            for transform in self.transforms:
                transform.forget(done.reshape(-1))
        return tuple(outcome.values())

    def _randoms(self) -> list[PopulationRandom]:
        return [random for random in (self.bare_env.random, self.policy.random) if random is not None]

    # -------------------------------------------------------------------------------------------------- a step

    @torch.no_grad()
    def _before(self) -> torch.Tensor:
        """The simulator's inputs; what was seen and done goes into the batch."""
        with tf32(self.tf32):
            *seen, inputs = self._parts["before"]()
        self._write("before", seen)
        self._action = dict(zip(self._keys["before"], seen, strict=True))["action",]
        return inputs

    @torch.no_grad()
    def _beside(self) -> None:
        with tf32(self.tf32):
            found = self._parts["side"]()
        self._write("side", found)

    @torch.no_grad()
    def _after(self) -> None:
        with tf32(self.tf32):
            outcome = self._parts["after"](self._action)
        self._write("after", outcome)
        self._time += 1

    def _write(self, part: str, values: Sequence[torch.Tensor]) -> None:
        """The running step's rows of the batch, [T, P, N, ...]."""
        for key, value in zip(self._keys[part], values, strict=True):
            if key not in self._rows:
                self._rows[key] = torch.zeros(self.horizon, *value.shape, dtype=value.dtype, device=value.device)
            self._rows[key].index_copy_(0, self._time, value.unsqueeze(0))

    # -------------------------------------------------------------------------------------------------- a batch

    def _collect(self) -> TensorDict:
        self._time.zero_()
        if self._graphs:
            self._replay()
        else:
            self._rows = {}  # a batch of its own
            for _ in range(self.horizon):
                inputs = self._before()
                if self._with_side:
                    self._beside()
                self.bare_env.simulate(inputs)
                self._after()
        return self._batch({key: value.movedim(0, 2) for key, value in self._rows.items()})

    def _replay(self) -> None:
        for random in self._randoms():
            random.renew()
        before, after, *side = self._graphs
        here, beside = torch.cuda.current_stream(self._time.device), self._side_stream
        for _ in range(self.horizon):
            before.replay()
            for graph in side:
                beside.wait_stream(here)
                with torch.cuda.stream(beside):
                    graph.replay()
            self._simulator.launch()
            if side:
                here.wait_stream(beside)
            after.replay()

    # -------------------------------------------------------------------------------------------------- capture

    def _begin(self) -> None:
        if self._wants_capture:
            self._capture()

    def _capture(self) -> None:
        """Warm up, trace, capture the graphs, and put everything back to where it was."""
        simulator, device, randoms = self._launched(), self._time.device, self._randoms()
        physics, states = simulator.state_dict(), [random.state_dict() for random in randoms]
        buffers = self._hold_state()
        warm_up(self._one_step, device)
        if self._compiled:
            self._trace(buffers)
            warm_up(self._one_step, device)
        self._time.zero_()
        first, _ = captured(lambda: simulator.load(self._before()))
        side = [captured(self._beside)[0]] if self._with_side else []
        last, _ = captured(self._after, pool=first.pool())
        self._graphs, self._side_stream = [first, last, *side], torch.cuda.Stream(device)
        torch.cuda.synchronize(device)
        for one in buffers:
            one.restore()
        simulator.load_state_dict(physics)
        for random, state in zip(randoms, states, strict=True):
            random.load_state_dict(state)

    def _launched(self) -> LaunchedSimulator:
        simulator = self.bare_env.launched_simulator()
        if simulator is None:
            raise TypeError(
                f"{type(self.bare_env).__name__} has no launched_simulator, so its steps cannot be captured. "
                "Take PopulationCollector, or capture=False."
            )
        return simulator

    def _hold_state(self) -> list[StaticBuffers]:
        """From here on a step leaves its state in the memory where it found it, and takes prefetched noise."""
        self._simulator = self._launched()
        replaced: list[ReplacedState] = [*self.bare_env.replaced_state()]
        for transform in self.transforms:
            replaced += transform.replaced_state()
        buffers = [StaticBuffers(one.owner, one.names) for one in replaced]
        for random in self._randoms():
            random.prefetched = PrefetchedNoise(random, self.horizon, self._time)

        def copied_back(part: Part, *given: torch.Tensor) -> tuple[torch.Tensor, ...]:
            result = part(*given)
            for one in buffers:
                one.copy_back()
            return result

        def after(action: torch.Tensor) -> tuple[torch.Tensor, ...]:
            self._simulator.flag_diverged()
            return self._end_step(action)

        self._parts["before"], self._parts["after"] = (
            partial(copied_back, self._begin_step),
            partial(copied_back, after),
        )
        return buffers

    def _one_step(self) -> None:
        """A step as it is captured: what `simulate` does around the physics belongs to the parts before and after."""
        self._time.zero_()
        self._simulator.load(self._before())
        if self._with_side:
            self._beside()
        self._simulator.launch()
        self._after()

    def _trace(self, buffers: Sequence[StaticBuffers], compiled: bool = True) -> None:
        """Put traced graphs in place of the parts of a step that has been taken once with its state held."""
        memory = self._simulator.memory()
        state = [*(tensor for one in buffers for tensor in one.fixed.values()), *memory, self._time]
        for name in ("before", "side", "after") if self._with_side else ("before", "after"):
            given = [self._action] if name == "after" else []
            self._parts[name] = _traced(self._parts[name], given, state, compiled)


def _traced(part: Part, given: Sequence[torch.Tensor], state: Sequence[torch.Tensor], compiled: bool) -> Part:
    """The traced graph of a part of a step; given: what it is called with;
    state: what else it reads, and changes in place."""
    with explained():
        graph = TracedGraph(lambda *tensors: part(*tensors[: len(given)]), [*given, *state], compiled)
    return lambda *given: graph(*given, *state)
