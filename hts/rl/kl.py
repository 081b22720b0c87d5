"""The KL divergence to a reference policy: KL(pi || reference), the policy that is trained first."""

from __future__ import annotations

import math

import torch
from tensordict.nn import CompositeDistribution
from torch.distributions import (
    Categorical,
    ComposeTransform,
    Distribution,
    Gumbel,
    HalfNormal,
    Independent,
    MultivariateNormal,
    OneHotCategorical,
    Pareto,
    Transform,
    TransformedDistribution,
    constraints,
    kl_divergence,
)

from hts.rl.possible import beyond_reach, name_of, support_of

LIMITED = (
    constraints.interval,
    constraints.half_open_interval,
    constraints.greater_than,
    constraints.greater_than_eq,
    constraints.less_than,
)
FORMULAS = Gumbel, HalfNormal, Pareto
"""Squashed distributions of which torch knows the KL for any parameters, that of the bijection among them."""


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
    such an action (`rsample`), as of mixtures; ValueError for distributions of different actions, of other states, or
    for a reference of actions within limits (a squashed one) of a policy whose actions have none, or go further: that
    KL is infinite. Of two that both have limits these are compared on a CPU alone.
    """
    return kl_of(policy, reference, squashed_alike(policy, reference))


def squashed_alike(policy: Distribution, reference: Distribution) -> bool:
    """Whether both are squashed by the same bijection. Looks at limits, which waits for a GPU."""
    squashed, other = _squashed(policy), _squashed(reference)
    return squashed is not None and other is not None and squashed.transforms == other.transforms


def learned(policy: Distribution) -> bool:
    """Whether a policy is squashed by a bijection that depends on its parameters, so that a gradient step makes another
    one of it. Where no gradients are kept nothing tells."""
    squashed = _squashed(policy)
    return squashed is not None and any(map(_is_learned, squashed.transforms))


def _is_learned(transform: Transform) -> bool:
    if isinstance(transform, ComposeTransform):
        return any(map(_is_learned, transform.parts))
    held = vars(transform).values()
    return any(
        one.requires_grad if isinstance(one, torch.Tensor) else isinstance(one, Transform) and _is_learned(one)
        for one in held
    )


def kl_of(policy: Distribution, reference: Distribution, alike: bool) -> torch.Tensor:
    """`distribution_kl`; alike: what `squashed_alike` said of the two."""
    _check_alike(policy, reference)
    first, second = policy, reference
    squashed, other = _squashed(policy), _squashed(reference)
    if alike and squashed is not None and other is not None:
        first, second = squashed.base_dist, other.base_dist
    if not torch.compiler.is_compiling():  # which cannot look at what a distribution may do
        _check_reach(first, second)
    elif not alike and squashed is not None and other is not None and not isinstance(squashed, FORMULAS):
        return _kl_of_one_action(policy, reference)  # torch would compare the limits first
    choice, other_choice = _categorical(first), _categorical(second)
    try:
        if choice is not None and other_choice is not None:
            divergence = _categorical_kl(choice, other_choice)
        else:
            known = _uncompiled if isinstance(first, MultivariateNormal) else kl_divergence
            divergence = known(first, second)
    except NotImplementedError:
        return _kl_of_one_action(policy, reference)
    extra = divergence.ndim - len(policy.batch_shape)
    return divergence.sum(tuple(range(-extra, 0))) if extra else divergence


_uncompiled = torch.compiler.disable(kl_divergence)  # torch's formula of multivariate normals cannot be traced


def _check_alike(policy: Distribution, reference: Distribution) -> None:
    """Raise ValueError for what torch would broadcast: a KL per component, or of each state with each other. A
    composite of several distributions has no shape of its own and is not looked at."""
    if isinstance(policy, CompositeDistribution) or isinstance(reference, CompositeDistribution):
        return
    if policy.event_shape != reference.event_shape or not expands(reference.batch_shape, policy.batch_shape):
        told = (f"actions {tuple(one.event_shape)} in states {tuple(one.batch_shape)}" for one in (policy, reference))
        raise ValueError(f"The policy is of {next(told)}, its reference of {next(told)}; expected the same of both.")


def expands(shape: torch.Size, to: torch.Size) -> bool:
    """Whether what has this shape can be expanded to that one."""
    return len(shape) <= len(to) and all(own in (1, other) for own, other in zip(shape[::-1], to[::-1], strict=False))


def _check_reach(policy: Distribution, reference: Distribution) -> None:
    """Raise ValueError where the policy does, with some probability, what the reference never does: a density that
    is clamped at its limits, as a squashed one's, would make a finite number of that."""
    infinite = f"KL({name_of(policy)} || {name_of(reference)}) is infinite: the policy's actions"
    if limited(reference) is True and limited(policy) is False:
        raise ValueError(
            f"{infinite} have no limits, its reference's have. Expected the same kind of distribution of both."
        )
    beyond = beyond_reach(policy, reference)
    if beyond is not None:
        raise ValueError(
            f"{infinite} go to {beyond[0]:.4g}, its reference's to {beyond[1]:.4g}. Expected the same limits of both."
        )


def limited(distribution: Distribution) -> bool | None:
    """Whether the numbers of an action have limits, as far as types tell, for no value is looked at; None: they do
    not."""
    if isinstance(distribution, Independent):
        return limited(distribution.base_dist)
    if isinstance(distribution, TransformedDistribution):  # whose own `support` is that of its last transform alone
        return True if any(map(_limits, distribution.transforms)) else limited(distribution.base_dist)
    support = support_of(distribution)
    if support is None:
        return None
    return True if isinstance(support, LIMITED) else False if support is constraints.real else None


@torch.no_grad()
def in_reach(policy: Distribution, action: torch.Tensor, counted: torch.Tensor | None) -> torch.Tensor:
    """Actions, with others in steps that do not count, of the shape of counted: what stretches are filled up with may
    be beyond limits, and the gradient of a density that is not finite is NaN, though it counts for nothing."""
    if counted is None or limited(policy) is not True:
        return action
    return torch.where(counted, action, policy.sample())


def _limits(transform: Transform) -> bool:
    if isinstance(transform, ComposeTransform):
        return any(map(_limits, transform.parts))
    return isinstance(transform.codomain, LIMITED)


def _kl_of_one_action(policy: Distribution, reference: Distribution) -> torch.Tensor:
    try:
        action = policy.rsample()
    except NotImplementedError as error:
        names = name_of(policy), name_of(reference)
        raise NotImplementedError(
            f"torch knows no formula of KL({names[0]} || {names[1]}), and {names[0]} has no rsample, with which one "
            "action would stand for it. Give the policy a distribution that has either, such as TorchRL's TanhNormal."
        ) from error
    return policy.log_prob(action) - reference.log_prob(action)


def _categorical_kl(policy: Categorical, reference: Categorical) -> torch.Tensor:
    """sum_a p(a) (ln p(a) - ln q(a)) over what the policy may do. torch's own takes the difference of two -inf where
    an action is masked out of both, and the gradient of what it then sets to 0 is NaN. Infinite, without gradient,
    where the policy may do what the reference may not. Raises ValueError for another number of actions."""
    if policy.probs.shape[-1] != reference.probs.shape[-1]:
        told = policy.probs.shape[-1], reference.probs.shape[-1]
        raise ValueError(
            f"The policy chooses among {told[0]} actions, its reference among {told[1]}; expected as many."
        )
    possible = policy.probs > 0
    both = possible & (reference.probs != 0)
    ratio = torch.where(both, policy.logits, 0.0) - torch.where(both, reference.logits, 0.0)
    return torch.where((possible & ~both).any(-1), math.inf, (policy.probs * ratio).sum(-1))


def _categorical(distribution: Distribution) -> Categorical | None:
    """The choices that a distribution is made of: one, or independent ones; None for any other."""
    if isinstance(distribution, Independent):
        return _categorical(distribution.base_dist)
    if isinstance(distribution, OneHotCategorical):
        return Categorical(logits=distribution.logits, validate_args=False)
    return distribution if isinstance(distribution, Categorical) else None


def _squashed(distribution: Distribution) -> TransformedDistribution | None:
    """A squashed distribution, without what only says which dimensions are an action's; None for any other."""
    if isinstance(distribution, Independent):
        return _squashed(distribution.base_dist)
    return distribution if isinstance(distribution, TransformedDistribution) else None
