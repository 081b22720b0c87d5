"""The gradient of `population_loss` by what one candidate's networks give, written out for a CPU.

Between the networks and the loss lie some forty operations on a few thousand numbers, and through autograd as many
again, none of which is worth its call. Samples in columns: [J, B] for actions, [B] for the rest. `hts.rl.surrogate`
defines the loss; a test compares every gradient here with autograd's of it.
"""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor

from hts.rl.actor import LOG_2PI


def policy_gradient(
    mean: Tensor,
    log_std: Tensor,
    batch: Mapping[str, Tensor],
    multiplier: float,
    *,
    clip: float,
    entropy_coef: float,
    policy_on: float,
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """By mean [J, B] and log_std [J, 1], of

    policy_on (E[-min(rho A, clip(rho, 1 - eps, 1 + eps) A)] - h sum log sigma) + alpha E[KL(pi || reference)].

    batch: action, old_mean [J, B], log_prob, advantage [B], old_log_std [J, 1]; reference_mean, reference_log_std alike
    if there is a reference. Returns both gradients, E[-min(...)] and E[KL(old || pi)], nats.
    """
    joints, samples = mean.shape
    inverse = torch.exp(-log_std)
    z = torch.sub(batch["action"], mean).mul_(inverse)
    squares = z.square()
    # log pi(a) = -sum_j (z_j^2 / 2 + log sigma_j + log(2 pi) / 2), rho = pi(a) / pi_old(a)
    log_prob = squares.sum(0).mul_(-0.5).sub_(log_std.sum() + 0.5 * joints * LOG_2PI)
    ratio = log_prob.sub_(batch["log_prob"]).exp_()
    gain = ratio * batch["advantage"]
    clipped = ratio.clamp_(1 - clip, 1 + clip).mul_(batch["advantage"])
    loss = torch.minimum(gain, clipped).mean().neg_()
    # d rho / d log pi = rho, and where clipping decides, nothing: dL/d log pi = -rho A / B.
    by_log_prob = gain.masked_fill_(gain > clipped, 0.0).mul_(-policy_on / samples)
    # d log pi / d mean = z / sigma, d log pi / d log sigma = z^2 - 1
    by_mean = z.mul_(by_log_prob).mul_(inverse)
    by_log_std = torch.mv(squares, by_log_prob).sub_(by_log_prob.sum()).sub_(policy_on * entropy_coef).unsqueeze_(1)
    if "reference_mean" in batch:
        # KL = sum_j (sigma_j^2 + (mean_j - m_j)^2) / (2 s_j^2) - log(sigma_j / s_j) - 1/2 with m, s of the reference:
        # dKL/d mean = (mean - m) / s^2, dKL/d log sigma = sigma^2 / s^2 - 1
        precision = torch.exp(-2.0 * batch["reference_log_std"])
        by_mean.addcmul_(torch.sub(mean, batch["reference_mean"]), precision, value=multiplier / samples)
        by_log_std.add_(torch.exp(2.0 * log_std).mul_(precision).sub_(1.0), alpha=multiplier)
    # E[KL(old || pi)] = sum_j (e^2r_j + E[(old_mean_j - mean_j)^2] / sigma_j^2 - 1) / 2 - r_j,
    # r = ln(sigma_old / sigma)
    r = batch["old_log_std"] - log_std
    moved = torch.sub(batch["old_mean"], mean).mul_(inverse).square_().mean(1, keepdim=True)
    kl_old = torch.exp(2.0 * r).add_(moved).sub_(1.0).mul_(0.5).sub_(r).sum()
    return by_mean, by_log_std, loss, kl_old


def value_gradient(
    value: Tensor, old: Tensor, target: Tensor, *, clip: float, value_coef: float
) -> tuple[Tensor, Tensor]:
    """By value [B], of value_coef E[max((V - G)^2, (V_clip - G)^2)], and E[max(...)] itself; old, target [B]."""
    moved = torch.sub(value, old)
    error = torch.sub(value, target)
    limited = moved.clamp(-clip, clip)
    square, clipped = error.square(), torch.add(old, limited).sub_(target).square_()
    loss = torch.maximum(square, clipped).mean()
    # Where the clip decides, the value does not enter; within it both errors are the same. 0 x moved: NaN stays NaN.
    free = (square >= clipped).logical_or_(limited == moved)
    return torch.where(free, error, moved.mul_(0.0)).mul_(2.0 * value_coef / len(value)), loss
