"""Which actions a distribution never gives, as far as the kind of distribution tells."""

from __future__ import annotations

import torch
from torch.distributions import (
    ComposeTransform,
    Distribution,
    Independent,
    Transform,
    TransformedDistribution,
    constraints,
)
from torchrl.modules import MaskedCategorical, OneHotCategorical

ROUNDING = 1e-3  # of the width between two limits: actions that were kept in less precision, and scaled back


def impossible(policy: Distribution, action: torch.Tensor) -> torch.Tensor | None:
    """Where numbers of an action are beyond the policy's limits, or of none of its choices; None: nothing is known."""
    if isinstance(policy, Independent):
        return impossible(policy.base_dist, action)
    if isinstance(policy, TransformedDistribution):  # whose `support` TorchRL's TanhNormal cannot say
        return _beyond_squashing(policy.transforms, action)
    if isinstance(policy, OneHotCategorical | MaskedCategorical):  # they say of themselves what a Categorical does
        return None
    support = support_of(policy)
    if support is None:
        return None
    if isinstance(support, constraints.interval):
        return _beyond(support, action)
    whole = isinstance(support, constraints.integer_interval) or support is constraints.boolean
    return ~support.check(action) if whole else None


def support_of(distribution: Distribution) -> constraints.Constraint | None:
    """What each number of an action may be; None where the distribution does not say."""
    try:
        support = distribution.support
    except NotImplementedError:
        return None
    while isinstance(support, constraints.independent):
        support = support.base_constraint
    return support


def _beyond_squashing(transforms: list[Transform], action: torch.Tensor) -> torch.Tensor | None:
    """Of actions that were squashed (a tanh), then perhaps scaled and shifted."""
    parts = [part for one in transforms for part in (one.parts if isinstance(one, ComposeTransform) else [one])]
    for part in reversed(parts):
        if isinstance(part.codomain, constraints.interval):
            return _beyond(part.codomain, action)
        if part.codomain is not constraints.real:
            return None
        action = part.inv(action)
    return None


def _beyond(limits: constraints.interval, action: torch.Tensor) -> torch.Tensor:
    room = ROUNDING * (limits.upper_bound - limits.lower_bound)
    return (action < limits.lower_bound - room) | (action > limits.upper_bound + room)
