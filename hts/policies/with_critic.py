"""An actor from elsewhere, made a whole policy: its critic is new, because the critic of our task sees other things."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch

from hts.errors import PolicyError
from hts.rl.population import Population, Sizes

NEW_CRITIC = "new"
"""What the card of such a policy says under `made.critic`."""


def critic_line(made: Mapping[str, Any], warmup_batches: int) -> str | None:
    """What has to be said where a policy with this `made` of its card starts a training: that its critic is new and no
    batch is its own; None where there is nothing to say."""
    if made.get("critic") != NEW_CRITIC or warmup_batches > 0:
        return None
    return (
        "The policy to start from brings no critic, and nothing lets a new one learn before the policy moves: "
        "--set finetune.ppo.warmup_batches=20 does (docs/policies-from-elsewhere.md)."
    )


def with_new_critic(path: Path, actor: Mapping[str, torch.Tensor], sizes: Sizes, std: float) -> dict[str, torch.Tensor]:
    """All tensors of a policy: those given, the rest new. The critic's observation begins with the actor's, so it
    starts with the actor's normaliser there."""
    whole = Population(sizes, 1, init_std=std).candidate(0)
    for name, value in actor.items():
        if name not in whole or whole[name].shape != value.shape:
            expected = tuple(whole[name].shape) if name in whole else None
            raise PolicyError(f"{path}: '{name}' has shape {tuple(value.shape)}, expected {expected}.")
        if not bool(torch.isfinite(value).all()):
            raise PolicyError(f"{path}: '{name}' holds numbers that are not finite. Use an earlier checkpoint.")
        whole[name] = value.clone()
    for what in ("mean", "std"):
        whole[f"critic_observation_{what}"][: sizes.observation] = whole[f"observation_{what}"]
    return whole
