"""The specs that envs of hts have in common."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torchrl.data import Binary, Composite, Unbounded
from torchrl.envs import EnvBase

from hts.channels import Channel

FLAGS = ("done", "terminated", "truncated")


def make_specs(env: EnvBase, seen: Mapping[str, int], channels: Mapping[str, Channel] | None, actions: int) -> None:
    """Give an env of batch size [P, N] the specs of its float32 observations, of these sizes, and channels (None: it
    writes none), of so many actions, of one reward and of the FLAGS."""
    shape, device = env.batch_size, env.device

    def unbounded(*size: int) -> Unbounded:
        return Unbounded((*shape, *size), device=device)

    entries = {name: unbounded(size) for name, size in seen.items()}
    if channels is not None:
        own = {name: unbounded(*channel.shape) for name, channel in channels.items()}
        entries["channels"] = Composite(own, shape=shape, device=device)
    env.observation_spec = Composite(**entries, shape=shape, device=device)
    env.action_spec = unbounded(actions)
    env.reward_spec = unbounded(1)
    flag = Binary(1, (*shape, 1), device=device, dtype=torch.bool)
    env.done_spec = Composite({name: flag.clone() for name in FLAGS}, shape=shape, device=device)
