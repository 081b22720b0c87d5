"""The anchored PPO loss of a population: clipped surrogate + value loss + alpha x KL(pi || anchor).

TorchRL's `KLPENPPOLoss` is not this: it penalises the KL to the behaviour policy, in the other direction.
Nothing here reduces over candidates before the last sum, so nobody's gradient depends on the others.
`forward` computes; multipliers and centres change elsewhere, once per batch.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import torch

from hts.rl.actor import log_prob
from hts.rl.kl import gaussian_kl
from hts.rl.population import Population
from hts.rl.rows import row_mean


@dataclass(frozen=True)
class LossParts:
    """Mean over the minibatch of each part, shape [P]: to minimise `total`, the rest to report."""

    total: torch.Tensor
    policy: torch.Tensor
    value: torch.Tensor
    entropy: torch.Tensor
    kl_anchor: torch.Tensor
    kl_old: torch.Tensor


def anchored_ppo_loss(
    population: Population, batch: Mapping[str, torch.Tensor], multipliers: torch.Tensor, *,
    clip: float, value_coef: float, entropy_coef: float, policy_on: float | torch.Tensor = 1.0,
    members: slice = slice(None), normalised: bool = False, named: Mapping[str, torch.Tensor] | None = None,
) -> LossParts:  # fmt: skip
    """One minibatch [P, B]: observation, critic_observation, action, old_mean, log_prob, advantage (normalised per
    candidate), target (value target), old_value, old_log_std [P, 1, J]; anchor_mean, anchor_log_std if there is an anchor.

    L = -E[min(rho A, clip(rho, 1 - eps, 1 + eps) A)] + v E[max((V - G)^2, (V_clip - G)^2)] - h H + alpha KL(pi || anchor).
    policy_on: 0 fits the critic only. members: whose rows batch and multipliers hold, all without it; normalised: the
    observations are as the networks see them, which needs doing once for many minibatches; named: parameters to use
    instead of the population's own, stacked, [P, ...] by name.
    """
    parameters = population.named(members) if named is None else named
    mean, log_std = population.mean(batch["observation"], parameters, normalised), population.log_std(parameters)
    ratio = (log_prob(batch["action"], mean, log_std) - batch["log_prob"]).exp()
    advantage = batch["advantage"]
    policy = -row_mean(torch.minimum(ratio * advantage, ratio.clamp(1 - clip, 1 + clip) * advantage))
    value = population.value(batch["critic_observation"], parameters, normalised)
    old, target = batch["old_value"], batch["target"]
    clipped = old + (value - old).clamp(-clip, clip)
    value_loss = row_mean(torch.maximum((value - target).square(), (clipped - target).square()))
    entropy = log_std.sum(-1).squeeze(1)  # up to a constant
    total = policy_on * (policy - entropy_coef * entropy) + value_coef * value_loss
    if "anchor_mean" in batch:
        kl_anchor = row_mean(gaussian_kl(mean, log_std, batch["anchor_mean"], batch["anchor_log_std"]))
        total = total + multipliers * kl_anchor
    else:
        kl_anchor = torch.zeros_like(policy)
    with torch.no_grad():
        kl_old = row_mean(gaussian_kl(batch["old_mean"], batch["old_log_std"], mean, log_std))
    return LossParts(total, policy.detach(), value_loss.detach(), entropy.detach(), kl_anchor.detach(), kl_old)
