"""`walker-walk` of the dm_control suite, unmodified, behind TorchRL's own wrapper, as hts wants it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial

import torch
from tensordict import TensorDictBase
from torchrl.envs import DMControlEnv, SerialEnv

from hts.channels import Channel
from hts.envs.folded import FoldedEnv
from hts_walker.channels import channel_values
from hts_walker.robot import OBSERVATION, SPEC


def make_walker_env(
    num_candidates: int, num_envs: int, seconds: float, channels: Mapping[str, Channel], seeds: Sequence[int]
) -> FoldedEnv:
    """[P, N] walkers. Each ends with a time-out after `seconds` and never by a fall: the suite lets a walker lie."""
    # Instance n of every candidate has the same seed: candidates differ by what is tried on them, not by luck.
    makers = [
        partial(DMControlEnv, "walker", "walk", time_limit=seconds, random=(1_000_003 * seed + instance) % 2**32)
        for seed in seeds
        for instance in range(num_envs)
    ]
    return FoldedEnv(
        SerialEnv(len(makers), makers),
        num_candidates,
        dt=SPEC.physics_dt * SPEC.substeps,
        observation=[name for name, _ in OBSERVATION],
        channels=channels,
        values=_channels,
        action_limit=1.0,  # what the suite's own action spec allows
    )


def _channels(after: TensorDictBase, action: torch.Tensor) -> Mapping[str, torch.Tensor]:
    """after: the suite's observation after the step [W]; action: as sent [W, 6]."""
    return channel_values({name: after[name].float() for name, _ in OBSERVATION}, action, torch.stack)
