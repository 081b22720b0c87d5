"""The entropy of a policy, or one sample of it."""

from __future__ import annotations

from contextlib import suppress

import torch
from torch.distributions import Distribution
from torchrl.modules.distributions.utils import sample_and_log_prob

from hts.rl.possible import name_of


def entropy_of(policy: Distribution, like: torch.Tensor) -> torch.Tensor:
    """Entropy in each state, of the shape of like; by one sample where there is no closed form, of which TorchRL knows
    the density where a tanh has rounded it to its limit, too: from the action alone it would be any number there.
    Raises NotImplementedError where no gradient goes through such a sample."""
    with suppress(NotImplementedError):
        return policy.entropy().expand(like.shape)
    try:
        return -sample_and_log_prob(policy, reparameterize=True)[1].expand(like.shape)
    except NotImplementedError as error:
        raise NotImplementedError(
            f"torch knows no entropy of {name_of(policy)}, which has no rsample either, with which one action would "
            "stand for it. Make the loss with entropy_coeff=0, its default."
        ) from error
