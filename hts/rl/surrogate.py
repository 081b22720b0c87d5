"""The mathematics of the KL-constrained PPO loss, as functions of tensors that loss module and fast paths call.

L = -E[min(rho A, clip(rho, 1 - eps, 1 + eps) A)] - h H + v E[max((V - G)^2, (V_clip - G)^2)]
    + alpha E[KL(pi || reference)].

TorchRL's `KLPENPPOLoss` is not this: it penalises the KL to the behaviour policy, in the other direction. Nothing here
reduces over candidates, so nobody's gradient depends on the others, and nothing changes a coefficient.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import torch

from hts.rl.actor import LOG_2PI, log_prob
from hts.rl.kl import gaussian_kl
from hts.rl.population import Population
from hts.rl.rows import row_mean


def surrogate(log_ratio: torch.Tensor, advantage: torch.Tensor, clip: float) -> torch.Tensor:
    """-min(rho A, clip(rho, 1 - eps, 1 + eps) A) of each sample; log_ratio = ln pi(a) - ln pi_old(a), any shape."""
    ratio = log_ratio.exp()
    return -torch.minimum(ratio * advantage, ratio.clamp(1 - clip, 1 + clip) * advantage)


def value_error(value: torch.Tensor, target: torch.Tensor, old_value: torch.Tensor, clip: float | None) -> torch.Tensor:
    """(V - G)^2 of each sample; with clip the larger of it and the one with V kept within +-clip of the old value."""
    error = (value - target).square()
    if clip is None:
        return error
    clipped = old_value + (value - old_value).clamp(-clip, clip)
    return torch.maximum(error, (clipped - target).square())


@dataclass(frozen=True)
class LossParts:
    """Mean over the minibatch of each part, shape [P]: to minimise `total`, the rest to report."""

    total: torch.Tensor
    policy: torch.Tensor
    value: torch.Tensor
    entropy: torch.Tensor
    kl_reference: torch.Tensor
    kl_old: torch.Tensor


def population_loss(
    population: Population,
    batch: Mapping[str, torch.Tensor],
    multipliers: torch.Tensor,
    *,
    clip: float,
    value_coef: float,
    entropy_coef: float,
    policy_on: float | torch.Tensor = 1.0,
    normalised: bool = False,
    named: Mapping[str, torch.Tensor] | None = None,
) -> LossParts:
    """One minibatch [P, B]: observation, critic_observation, action, old_mean, log_prob, advantage (normalised per
    candidate), target (value target), old_value, old_log_std [P, 1, J]; reference_mean, reference_log_std if there is a
    reference.

    policy_on: 0 fits the critic only; normalised: the
    observations are as the networks see them, which needs doing once for many minibatches; named: parameters to use
    instead of the population's own, stacked, [P, ...] by name.
    """
    parameters = population.named() if named is None else named
    mean, log_std = population.mean(batch["observation"], parameters, normalised), population.log_std(parameters)
    value = population.value(batch["critic_observation"], parameters, normalised)
    return gaussian_loss(
        mean,
        log_std,
        value,
        batch,
        multipliers,
        clip=clip,
        value_coef=value_coef,
        entropy_coef=entropy_coef,
        policy_on=policy_on,
    )


def gaussian_loss(
    mean: torch.Tensor,
    log_std: torch.Tensor,
    value: torch.Tensor,
    batch: Mapping[str, torch.Tensor],
    multipliers: torch.Tensor,
    *,
    clip: float,
    value_coef: float,
    entropy_coef: float,
    policy_on: float | torch.Tensor = 1.0,
) -> LossParts:
    """The loss of policies N(mean [P, B, J], diag exp(2 log_std [P, 1, J])) and values [P, B];
    the rest as `population_loss`."""
    log_ratio = log_prob(batch["action"], mean, log_std) - batch["log_prob"]
    policy = row_mean(surrogate(log_ratio, batch["advantage"], clip))
    value_loss = row_mean(value_error(value, batch["target"], batch["old_value"], clip))
    entropy = (log_std + 0.5 * (1.0 + LOG_2PI)).sum(-1).squeeze(1)
    total = policy_on * (policy - entropy_coef * entropy) + value_coef * value_loss
    if "reference_mean" in batch:
        kl_reference = row_mean(gaussian_kl(mean, log_std, batch["reference_mean"], batch["reference_log_std"]))
        total = total + multipliers * kl_reference
    else:
        kl_reference = torch.zeros_like(policy)
    with torch.no_grad():
        kl_old = row_mean(gaussian_kl(batch["old_mean"], batch["old_log_std"], mean, log_std))
    return LossParts(total, policy.detach(), value_loss.detach(), entropy.detach(), kl_reference.detach(), kl_old)
