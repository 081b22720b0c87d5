"""The Lagrange multiplier of a bound on the KL divergence to a reference policy."""

from __future__ import annotations

import torch
from torch import nn

LARGEST_EXCESS = 2.0  # of KL / c - 1 in one update: one bad batch must not spend the training on getting back


class LagrangeMultiplier(nn.Module):
    """alpha <- [alpha + eta (KL / c - 1)]_+, once per batch and outside `forward`.

    bounds: c in nats, a float or [P]; infinity switches the bound off. rate: eta. It acts on KL / c, so that tight and
    loose bounds are approached in the same number of batches; alpha starts at 0: nothing pulls until the bound is near.

    Buffers value and bounds, both of the shape of bounds.
    """

    value: torch.Tensor
    bounds: torch.Tensor

    def __init__(self, bounds: float | torch.Tensor, rate: float = 0.05) -> None:
        super().__init__()
        limits = torch.as_tensor(bounds, dtype=torch.get_default_dtype())
        if not bool((limits > 0).all()):
            raise ValueError(f"kl_bound is {limits.tolist()}; expected positive numbers, infinity for no bound.")
        self.rate = rate
        self.register_buffer("bounds", limits.clone())
        self.register_buffer("value", torch.zeros_like(limits))

    def forward(self, kl: torch.Tensor) -> torch.Tensor:
        """alpha KL: what the loss adds. Changes nothing."""
        return self.value * kl

    @torch.no_grad()
    def update(self, kl: torch.Tensor) -> torch.Tensor:
        """kl, of the shape of bounds: mean KL over the batch's states with the parameters after its gradient steps.
        Returns the new value."""
        excess = torch.where(torch.isinf(self.bounds), 0.0, kl / self.bounds - 1.0).clamp(max=LARGEST_EXCESS)
        self.value = (self.value + self.rate * excess).clamp(min=0.0)
        return self.value
