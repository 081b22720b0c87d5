"""The KL divergence to a reference policy: KL(pi || reference), the policy that is trained first."""

from __future__ import annotations

import math

import torch
from tensordict.nn import CompositeDistribution
from torch.distributions import Categorical, Distribution, Independent, TransformedDistribution, kl_divergence


def gaussian_kl(
    mean: torch.Tensor, log_std: torch.Tensor, reference_mean: torch.Tensor, reference_log_std: torch.Tensor
) -> torch.Tensor:
    """KL(pi || reference) of diagonal Gaussians, summed over actions; [..., J] -> [...], nats.

    KL(p||q) = sum_j ln(s_q / s_p) + (s_p^2 + (m_p - m_q)^2) / (2 s_q^2) - 1/2.
    Order matters: the expectation is under the policy being trained, so pi comes first. Swapping the two would
    forbid what the reference does and pi does not, instead of what pi does and the reference does not.
    """
    ratio = log_std - reference_log_std
    scaled = (mean - reference_mean) * torch.exp(-reference_log_std)
    return (0.5 * (torch.exp(2 * ratio) + scaled.square() - 1.0) - ratio).sum(-1)


def distribution_kl(policy: Distribution, reference: Distribution) -> torch.Tensor:
    """KL(policy || reference) in each state, shape of `policy.batch_shape`, nats; differentiable in policy.

    In closed form where torch knows one. Both squashed by the same bijection (a tanh, to the same limits): that of what
    was squashed, since a bijection changes no KL. Otherwise ln policy(a) - ln reference(a) at one reparametrised action
    a ~ policy, which has the right mean. Raises NotImplementedError where torch knows neither a formula nor how to take
    such an action (`rsample`), as of mixtures; ValueError for distributions of different actions, or of other states.
    """
    _check_alike(policy, reference)
    first, second = policy, reference
    squashed, other = _squashed(policy), _squashed(reference)
    if squashed is not None and other is not None and squashed.transforms == other.transforms:
        first, second = squashed.base_dist, other.base_dist
    if isinstance(first, Categorical) and isinstance(second, Categorical):
        return _categorical_kl(first, second)
    try:
        divergence = kl_divergence(first, second)
    except NotImplementedError:
        action = policy.rsample()
        return policy.log_prob(action) - reference.log_prob(action)
    extra = divergence.ndim - len(policy.batch_shape)
    return divergence.sum(tuple(range(-extra, 0))) if extra else divergence


def _check_alike(policy: Distribution, reference: Distribution) -> None:
    """Raise ValueError for what torch would broadcast: a KL per component, or of each state with each other. A
    composite of several distributions has no shape of its own and is not looked at."""
    if isinstance(policy, CompositeDistribution) or isinstance(reference, CompositeDistribution):
        return
    states = len(reference.batch_shape)
    fits = len(policy.batch_shape) >= states and all(
        of_reference in (1, of_policy)
        for of_reference, of_policy in zip(reference.batch_shape[::-1], policy.batch_shape[::-1], strict=False)
    )
    if policy.event_shape != reference.event_shape or not fits:
        told = (f"actions {tuple(one.event_shape)} in states {tuple(one.batch_shape)}" for one in (policy, reference))
        raise ValueError(f"The policy is of {next(told)}, its reference of {next(told)}; expected the same of both.")


def _categorical_kl(policy: Categorical, reference: Categorical) -> torch.Tensor:
    """sum_a p(a) (ln p(a) - ln q(a)) over what the policy may do. torch's own takes the difference of two -inf where
    an action is masked out of both, and the gradient of what it then sets to 0 is NaN. Infinite, without gradient,
    where the policy may do what the reference may not."""
    possible = policy.probs > 0
    both = possible & (reference.probs != 0)
    ratio = torch.where(both, policy.logits, 0.0) - torch.where(both, reference.logits, 0.0)
    return torch.where((possible & ~both).any(-1), math.inf, (policy.probs * ratio).sum(-1))


def _squashed(distribution: Distribution) -> TransformedDistribution | None:
    """A squashed distribution, without what only says which dimensions are an action's; None for any other."""
    if isinstance(distribution, Independent):
        return _squashed(distribution.base_dist)
    return distribution if isinstance(distribution, TransformedDistribution) else None
