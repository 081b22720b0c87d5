"""What collectors that step an env by its parts ask of the env and of the policy, and what they say of a mistake."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from numbers import Integral
from typing import Any

import torch
from tensordict import TensorDictBase
from torch import nn

from hts.rl.actor import PopulationActor
from hts.rl.task_env import SplitStepEnv

Key = tuple[str, ...]
FLAGS = ("terminated", "truncated", "done")


@dataclass
class Said:
    """What an env said of its first step, kept apart from the env's own memory: tensors by key, and the reward."""

    step: dict[Key, torch.Tensor]
    reward: torch.Tensor

    @classmethod
    def of(cls, env: SplitStepEnv, step: Mapping[Key, torch.Tensor], ended: Any) -> Said:
        return cls({key: value.clone() for key, value in step.items()}, checked_rewards(env, [ended])[0].clone())

    def check(self, env: SplitStepEnv, step: Mapping[Key, torch.Tensor], reward: torch.Tensor) -> None:
        """Hold it against the same after later steps."""
        changed = [".".join(key) for key, value in self.step.items() if not _same(value, step[key])]
        if changed:
            raise RuntimeError(
                f"{type(env).__name__} changes {', '.join(changed)} of a step in place while later steps are taken, so "
                "batches would hold another step's values. Give new tensors in observations() and end_step()."
            )
        if not _same(self.reward, reward):
            raise RuntimeError(
                f"{type(env).__name__} gives other rewards for a step once later steps were taken, so batches would "
                "hold wrong ones: what end_step() gives must be new tensors (.clone() of a state that is changed in "
                "place), and rewards() the same for any number of steps."
            )


def check_frames(frames_per_batch: int, total_frames: int, per_step: int) -> None:
    """Raises TypeError for numbers of frames that are none, ValueError for a batch that is not whole steps."""
    for name, given in (("frames_per_batch", frames_per_batch), ("total_frames", total_frames)):
        if not isinstance(given, Integral):
            raise TypeError(f"{name} is {given!r}, a {type(given).__name__}; expected a whole number of frames.")
    if frames_per_batch <= 0 or frames_per_batch % per_step:
        raise ValueError(
            f"frames_per_batch is {frames_per_batch}, expected a multiple of the {per_step} env instances."
        )


def weights_of(given: Any, policy: PopulationActor) -> dict[str, torch.Tensor]:
    """State of a policy out of what was given as its weights. Raises TypeError for what holds none, ValueError for that
    of another kind of module."""
    if isinstance(given, nn.Module):
        given = given.state_dict()
    elif isinstance(given, TensorDictBase):
        given = given.flatten_keys(".").to_dict()
    if not isinstance(given, Mapping):
        raise TypeError(f"The weights are a {type(given).__name__}; expected a PopulationActor, or its state_dict().")
    own = policy.state_dict()
    others = [*(name for name in own if name not in given), *(name for name in given if name not in own)]
    if others:
        raise ValueError(
            f"The weights are {', '.join(map(str, given)) or 'none'}, expected {', '.join(own)}: those of a "
            f"PopulationActor of {policy.population.count} candidates."
        )
    return dict(given)


def check_policy(env: SplitStepEnv, policy: PopulationActor) -> None:
    """Raises TypeError for another kind of policy, ValueError for one with another number of candidates than env, or of
    other sizes than env's specs say."""
    if not isinstance(policy, PopulationActor):
        raise TypeError(
            f"policy is a {type(policy).__name__}, expected a PopulationActor, which acts for all candidates."
        )
    candidates = env.batch_size[0]
    found = len(range(policy.population.count)[policy.members])
    if found != candidates:
        raise ValueError(f"policy has {found} candidates, env {candidates}: give both as many.")
    if policy.random is not None and len(policy.random.generators) != candidates:
        raise ValueError(
            f"the policy's random has {len(policy.random.generators)} generators, expected one for each of the "
            f"{candidates} candidates: PopulationRandom takes a seed for each."
        )
    sizes, named = policy.population.sizes, {**env.observation_spec, **env.full_action_spec}
    wanted = {"observation": sizes.observation, "critic_observation": sizes.critic_observation, "action": sizes.action}
    for name, size in wanted.items():
        if name in named and named[name].shape[-1:] != (size,):
            raise ValueError(
                f"the policy's {name} has {size} numbers, env's {tuple(named[name].shape)}: give both as many, with "
                f"Sizes({name}={named[name].shape[-1]}, ...)."
            )


def check_flags(env: SplitStepEnv, flags: Mapping[str, torch.Tensor]) -> None:
    """Raises ValueError unless `end_step` gave terminated, truncated and done, bool [P, N, 1]."""
    expected = (*env.batch_size, 1)
    for name in FLAGS:
        flag = flags.get(name)
        if flag is None or tuple(flag.shape) != expected or flag.dtype != torch.bool:
            found = "nothing" if flag is None else f"{tuple(flag.shape)} of {flag.dtype}"
            raise ValueError(
                f"{type(env).__name__}.end_step() gave {found} as {name}, expected {expected} of torch.bool, one for "
                "each instance."
            )


def check_seen(env: SplitStepEnv, policy: PopulationActor, seen: Mapping[str, torch.Tensor]) -> None:
    """Raises ValueError unless `observations` gave what the policy reads, [P, N, O] in the policy's precision."""
    found, sizes = seen.get("observation"), policy.population.sizes
    kind, expected = policy.population.vectors[0].dtype, (*env.batch_size, sizes.observation)
    if found is None or tuple(found.shape) != expected or found.dtype != kind:
        given = f"only {sorted(seen)}" if found is None else f"{tuple(found.shape)} of {found.dtype}"
        raise ValueError(
            f"{type(env).__name__}.observations() gave {given} as observation, expected {expected} of {kind}: that is "
            "what the policy reads."
        )


def checked_rewards(env: SplitStepEnv, steps: Sequence[Any]) -> torch.Tensor:
    """Rewards of steps, [T, P, N]. Raises ValueError for anything else: what has as many numbers in another order would
    be given to other steps."""
    found, expected = env.rewards(steps), (len(steps), *env.batch_size)
    if not isinstance(found, torch.Tensor) or tuple(found.shape) != expected:
        given = f"{tuple(found.shape)}" if isinstance(found, torch.Tensor) else f"a {type(found).__name__}"
        raise ValueError(
            f"{type(env).__name__}.rewards() gave {given} for {len(steps)} steps, expected a tensor {expected}: time "
            "first, then candidates and env instances."
        )
    return found


def _same(one: torch.Tensor, other: torch.Tensor) -> bool:
    if not one.is_floating_point():
        return torch.equal(one, other)
    return torch.allclose(one, other, rtol=1e-4, atol=1e-6, equal_nan=True)
