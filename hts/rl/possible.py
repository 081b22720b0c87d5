"""Which actions a distribution never gives, as far as the kind of distribution tells."""

from __future__ import annotations

import math

import tensordict.nn as tensordict_nn
import torch
from torch.distributions import (
    ComposeTransform,
    Distribution,
    Independent,
    OneHotCategorical,
    TransformedDistribution,
    constraints,
)
from torchrl import modules
from torchrl.modules.distributions import truncated_normal

ROUNDING = 1e-3  # of the numbers at a limit: actions that were kept in less precision, and scaled back
ONE_HOT = (
    OneHotCategorical,
    modules.OneHotCategorical,
    modules.MaskedOneHotCategorical,
    tensordict_nn.distributions.OneHotCategorical,
)
"""All but torch's are Categoricals, and say of their actions what those do."""
NORMALISED = truncated_normal.TruncatedNormal, tensordict_nn.distributions.TruncatedNormal
"""Those whose `support` is of (action - loc) / scale."""

Limits = tuple[torch.Tensor, torch.Tensor]


def impossible(policy: Distribution, action: torch.Tensor) -> torch.Tensor | None:
    """Where numbers of an action are beyond the policy's limits, or of none of its choices; None: nothing is known.
    Limits that move with the policy's parameters are not known: what it did before may be beyond them now. Looks at
    values, which waits for a GPU."""
    if isinstance(policy, ONE_HOT):
        bad = _not_one_hot(action)
        return bad if not isinstance(policy, modules.MaskedCategorical) else bad | _masked(policy, action).unsqueeze(-1)
    if isinstance(policy, modules.MaskedCategorical):
        bad = ~constraints.integer_interval(0, policy.num_samples - 1).check(action)
        return bad if bool(bad.any()) else _masked(policy, action)  # whose `log_prob` takes no other
    if isinstance(policy, Independent) and not isinstance(policy, modules.TruncatedNormal):
        return impossible(policy.base_dist, action)
    support = support_of(policy)
    if support is not None and support.is_discrete:
        bad = ~support.check(action)
        return bad.reshape(*bad.shape, *(1,) * support.event_dim).expand(action.shape)
    limits = _limits_of(policy)
    if limits is None or any(limit.requires_grad for limit in limits):
        return None
    lower, upper = limits
    if bool(lower.isneginf().all() and upper.isposinf().all()):
        return None
    rounding = max(ROUNDING, torch.finfo(action.dtype).eps) if action.is_floating_point() else ROUNDING
    room = _largest(limits) * rounding
    return (action < lower - room) | (action > upper + room)


def beyond_reach(policy: Distribution, reference: Distribution) -> tuple[float, float] | None:
    """A limit of the policy that lies beyond the reference's, and that; None: none does, or nothing is known, as on a
    GPU, which is not asked."""
    own, other = _limits_of(policy), _limits_of(reference)
    if own is None or other is None or any(limit.device.type != "cpu" for limit in (*own, *other)):
        return None
    room = _largest(other) * ROUNDING
    for far, near, sign in zip(own, other, (-1.0, 1.0), strict=True):
        far, near = torch.broadcast_tensors(far.detach(), near)
        beyond = sign * far > sign * near + room
        if bool(beyond.any()):
            return float(far[beyond][0]), float(near[beyond][0])
    return None


def name_of(distribution: Distribution) -> str:
    """The kind of distribution, in a word; not that it is one of several components."""
    return type(distribution.base_dist if type(distribution) is Independent else distribution).__name__


def support_of(distribution: Distribution) -> constraints.Constraint | None:
    """What each number of an action may be; None where the distribution does not say, as TorchRL's TanhNormal."""
    if isinstance(distribution, modules.TanhNormal):  # whose property is broken
        return None
    try:
        support = distribution.support
    except NotImplementedError:
        return None
    while isinstance(support, constraints.independent):
        support = support.base_constraint
    return None if constraints.is_dependent(support) else support


def _not_one_hot(action: torch.Tensor) -> torch.Tensor:
    """Where numbers are neither 0 nor 1, or nothing is chosen; of choices that are equally likely the mode has several
    ones."""
    numbers = action.float()
    between = torch.minimum(numbers.abs(), (numbers - 1.0).abs()) > ROUNDING
    return between | (numbers.sum(-1, keepdim=True) < 1.0 - ROUNDING)


def _masked(policy: modules.MaskedCategorical, action: torch.Tensor) -> torch.Tensor:
    """Where a choice is one that the mask forbids."""
    return policy.log_prob(action) == -math.inf


def _limits_of(policy: Distribution) -> Limits | None:
    """Between which numbers actions lie, perhaps without end; None: not known."""
    if isinstance(policy, Independent) and not isinstance(policy, modules.TruncatedNormal):
        return _limits_of(policy.base_dist)
    if isinstance(policy, modules.TruncatedNormal):
        return policy.low, policy.high
    if isinstance(policy, NORMALISED):
        return tuple((policy.loc + policy.scale * limit).detach() for limit in (policy.a, policy.b))
    support = support_of(policy)
    if isinstance(policy, TransformedDistribution) and (support is None or not _says_itself(policy)):
        limits = _images(policy)
        if limits is not None and not any(limit.requires_grad for limit in limits):
            return limits
        if support is constraints.real:  # of its last transform
            return None
    if isinstance(support, constraints.interval | constraints.half_open_interval):
        return torch.as_tensor(support.lower_bound), torch.as_tensor(support.upper_bound)
    if isinstance(support, constraints.greater_than | constraints.greater_than_eq):
        return torch.as_tensor(support.lower_bound), torch.tensor(math.inf)
    if isinstance(support, constraints.less_than):
        return torch.tensor(-math.inf), torch.as_tensor(support.upper_bound)
    if support is constraints.simplex:
        return torch.tensor(0.0), torch.tensor(1.0)
    return (torch.tensor(-math.inf), torch.tensor(math.inf)) if support is constraints.real else None


def _says_itself(policy: TransformedDistribution) -> bool:
    """Whether the class knows its support, as `Gumbel` does; else it is said of the last transform alone."""
    return type(policy).support is not TransformedDistribution.support


def _largest(limits: Limits) -> torch.Tensor:
    """The largest number at limits, their distance among them, 0 where there are none."""
    lower, upper = torch.broadcast_tensors(*limits)
    numbers = torch.stack([upper - lower, lower.abs(), upper.abs()])
    return numbers.masked_fill(numbers.isinf(), 0.0).amax(0)


def _images(policy: TransformedDistribution) -> Limits | None:
    """What becomes of the limits of what is transformed; None where a transform is not of single numbers."""
    limits = _limits_of(policy.base_dist)
    parts = [part for one in policy.transforms for part in (one.parts if isinstance(one, ComposeTransform) else [one])]
    for part in parts:
        try:
            part.sign  # noqa: B018 -- of those that go up, or down, in each number alone
        except NotImplementedError:
            return None
        if limits is None:
            return None
        ends = [part(limit) for limit in limits]
        limits = torch.minimum(*ends), torch.maximum(*ends)
    return limits
