"""Collection of the velocity task: what TorchRL's Collector would collect, to the bit, with less around the physics.

The Collector asks after every step whether an episode has ended, and puts each step together as nested TensorDicts. `Rollout`
is for a CPU: it does in a step only what the next step waits for, and the rest once per batch, in fewer and larger
operations. On a GPU `hts.rl.captured_collector` launches each step as CUDA graphs.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import torch
from tensordict import TensorDict
from torchrl.envs import EnvBase
from torchrl.envs.transforms import Transform, TransformedEnv

from hts.envs.rewards import Motion
from hts.envs.velocity import VelocityEnv
from hts.measurement.transform import Measured
from hts.rl.population import Population
from hts.rl.random import PopulationRandom

Key = tuple[str, ...]

REPLACED = ("_step", "_reset", "finish", "finish_for_now", "rewards_of", "_result")
"""Methods that the Collector reaches and a rollout may not: a task that changes one of them must go through the Collector."""


def can_roll_out(env: EnvBase) -> bool:
    """Whether env is the velocity task with nothing but measurement models in it; TorchRL's Collector takes any other, and
    one derived from the task that steps, rewards or resets in a way of its own."""
    bare, transforms = _taken_apart(env)
    return (
        isinstance(bare, VelocityEnv)
        and all(getattr(type(bare), name) is getattr(VelocityEnv, name) for name in REPLACED)
        and all(isinstance(transform, Measured) for transform in transforms)
    )


def _taken_apart(env: EnvBase) -> tuple[EnvBase, list[Transform]]:
    if not isinstance(env, TransformedEnv):
        return env, []
    transform = env.transform
    return env.base_env, list(transform) if isinstance(transform, Iterable) else [transform]


class Rollout:
    """Batches [P, N, T] of a population's steps. Keys: observation, critic_observation, action, action_mean, and under
    "next": reward, terminated, truncated, ("real_reward", objective), critic_observation [P, N, 1, O_c] of the last step.
    """

    captured = False  # whether every batch lies in the memory in which the last one lay

    def __init__(self, env: EnvBase, population: Population, noise: PopulationRandom, horizon: int) -> None:
        bare, self.transforms = _taken_apart(env)
        assert isinstance(bare, VelocityEnv)
        self.env, self.population, self.noise, self.horizon = bare, population, noise, horizon
        self.device = bare.device
        self._started = False

    @torch.no_grad()
    def collect(self) -> TensorDict:
        """The next T steps of every world."""
        if not self._started:
            self._started = True
            self.env.reset()  # goes on where a checkpoint ended, if one was loaded
            self._start()
        return self._collect()

    def _start(self) -> None:
        """After the first episodes have begun."""

    def _decide(self) -> tuple[torch.Tensor, ...]:
        """A step before its physics: observation, critic observation, action, its mean, actuator inputs."""
        observation, critic_observation = self.env.observations()
        mean = self.population.mean(observation)
        action = mean + self.population.log_std().exp() * self.noise.normal(*mean.shape[1:])
        return observation, critic_observation, action, mean, self.env.begin(action)

    def _collect(self) -> TensorDict:
        steps: dict[Key, list[torch.Tensor]] = {}
        seen: dict[int, list[torch.Tensor]] = {index: [] for index in range(len(self.transforms))}
        motions: list[Motion] = []
        for _ in range(self.horizon):
            observation, critic_observation, action, mean, ctrl = self._decide()
            self.env.engine.step(ctrl)
            motion, out = self.env.finish_for_now(action)
            motions.append(motion)
            channels = self.env.channel_values()
            for index, transform in enumerate(self.transforms):
                seen[index].append(transform.keep(channels))
            step = {
                ("observation",): observation, ("critic_observation",): critic_observation, ("action",): action,
                ("action_mean",): mean, ("next", "terminated"): out["terminated"], ("next", "truncated"): out["truncated"],
                ("done",): out["done"],
            }  # fmt: skip
            for key, value in step.items():
                steps.setdefault(key, []).append(value)
            last = self.env.observations()[1]
            if bool(out["done"].any()):
                self.env.start_episodes(out["done"].squeeze(-1))
        rows = {key: torch.stack(values, 2) for key, values in steps.items()}
        ended = rows.pop(("done",)).movedim(2, 0).reshape(self.horizon, -1)
        rewards = {("reward",): self.env.rewards_of(motions)}
        for index, transform in enumerate(self.transforms):
            rewards[transform.out_keys[1]] = transform.follow(torch.stack(seen[index]), ended)
        # Laid out alike however many candidates there are: sums take the order of the memory.
        for key, value in rewards.items():
            rows["next", *key] = value.view(self.horizon, *self.env.batch_size, 1).movedim(0, 2).contiguous()
        return self._batch(rows, last)

    def _batch(self, rows: dict[Key, torch.Tensor], last: torch.Tensor) -> TensorDict:
        """rows [P, N, T, ...] by name; last: what the critic saw after the last step."""
        batch = TensorDict({}, batch_size=self.env.batch_size, device=self.device)
        everything: dict[Any, torch.Tensor] = {**rows, ("next", "critic_observation"): last.unsqueeze(2)}
        for key, value in everything.items():
            batch[key] = value
        return batch
