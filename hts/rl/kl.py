"""The bound of Algorithm 1: E_{s~pi}[KL(pi || anchor)] <= c, held by a Lagrange multiplier per candidate."""

from __future__ import annotations

import torch


def gaussian_kl(
    mean: torch.Tensor, log_std: torch.Tensor, anchor_mean: torch.Tensor, anchor_log_std: torch.Tensor
) -> torch.Tensor:
    """KL(pi || anchor) of diagonal Gaussians, summed over actions; [..., J] -> [...], nats.

    KL(p||q) = sum_j ln(s_q / s_p) + (s_p^2 + (m_p - m_q)^2) / (2 s_q^2) - 1/2.
    Order matters: the expectation is under the policy being trained, so pi comes first. Swapping the two would
    forbid what the anchor does and pi does not, instead of what pi does and the anchor does not.
    """
    ratio = log_std - anchor_log_std
    scaled = (mean - anchor_mean) * torch.exp(-anchor_log_std)
    return (0.5 * (torch.exp(2 * ratio) + scaled.square() - 1.0) - ratio).sum(-1)


class Multipliers:
    """alpha <- [alpha + eta (KL - c)]_+ for each candidate, once per batch.

    bounds [P]: c in nats, infinity switches a candidate's bound off. eta acts on KL / c, so that tight and
    loose bounds are approached in the same number of batches; alpha starts at 0: nothing pulls until the bound is near.
    """

    def __init__(self, bounds: torch.Tensor, rate: float):
        self.bounds, self.rate = bounds, rate
        self.value = torch.zeros_like(bounds)

    def update(self, kl: torch.Tensor) -> None:
        """kl [P]: mean KL over the batch, measured with the parameters it ends with."""
        free = torch.isinf(self.bounds)
        excess = torch.where(free, 0.0, kl / self.bounds - 1.0).clamp(max=2.0)
        self.value = (self.value + self.rate * excess).clamp(min=0.0)

    def state_dict(self) -> dict[str, torch.Tensor]:
        return {"value": self.value.clone(), "bounds": self.bounds.clone()}

    def load_state_dict(self, state) -> None:
        self.value = state["value"].to(self.bounds.device).clone()
